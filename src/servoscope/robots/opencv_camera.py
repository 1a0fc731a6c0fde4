"""A camera that OpenCV opens: on USB, on the network, or a video file."""

from __future__ import annotations

import os
import threading
import time
import warnings
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from servoscope.errors import CameraFaultError, ServoscopeWarning
from servoscope.robots.arrivals import Arrivals
from servoscope.robots.camera_image import camera_image
from servoscope.robots.options import check_range, split_options
from servoscope.wording import listing, one_line

Image = NDArray[np.uint8]

OPTIONS: dict[str, Callable[[str], Any]] = {
    "width": int,
    "height": int,
    "exposure": float,
    "gain": float,
    "focus": float,
    "white_balance": float,
    "image_width": int,
    "delay": float,
    "skip": int,
    "timeout": float,
}
"""Of ``opencv:SOURCE?name=value``."""

BUFFERED = 6
"""Images that a camera may have taken, or begun, before it is asked for one."""

_MOST_FAILURES = 20
_PAUSE = 0.02
_SETTLING = 20
_CHANGE = 0.25
# What drivers call an exposure that is not automatic; elsewhere it is 0.
_MANUAL_EXPOSURE = {"V4L2": 1.0, "GSTREAMER": 1.0, "DSHOW": 0.25, "MSMF": 0.25}


def opencv_camera(text: str) -> OpenCVCamera:
    """The camera that is written ``opencv:SOURCE?name=value``, without the kind."""
    source, options = split_options(text, OPTIONS)
    return OpenCVCamera(
        int(source) if source.isdecimal() and len(source) < 6 else source, **options
    )


class OpenCVCamera:
    """A camera that `cv2.VideoCapture` opens.

    A thread takes every image from it, so that none waits for long. A reading skips six images
    after the call: four may lie in the buffers of a driver, one may be exposed, and one be on its
    way. What the camera
    sets by itself (exposure, focus, white balance) is held at what it found in the first second.

    Parameters
    ----------
    source : int or str
        Number of the camera, a device such as ``/dev/video0``, an address such as
        ``rtsp://192.0.2.7/live``, or a video file, whose images are read one after the other.
    width, height : int, optional
        Size that the camera is set to, [px].
    exposure, gain, focus, white_balance : float, optional
        In the units of its driver; by default what the camera found by itself.
    image_width : int, optional
        Width that images are resized to, as `servoscope import` does, [px].
    delay : float
        How much later than it was taken an image arrives, beyond those that are skipped, [s]: set
        it for cameras on a network.
    skip : int
        Images that are skipped after the call.
    timeout : float
        How long an image may take, [s].

    Raises
    ------
    InvalidInputError
        If a number is not of its range.
    CameraFaultError
        If the camera cannot be opened, or does not take the size.

    Warns
    -----
    ServoscopeWarning
        If something that the camera sets by itself cannot be held.
    """

    def __init__(
        self,
        source: int | str,
        *,
        width: int | None = None,
        height: int | None = None,
        exposure: float | None = None,
        gain: float | None = None,
        focus: float | None = None,
        white_balance: float | None = None,
        image_width: int | None = None,
        delay: float = 0.0,
        skip: int = BUFFERED,
        timeout: float = 5.0,
    ) -> None:
        for name, size in (("width", width), ("height", height), ("image_width", image_width)):
            check_range(name, size, 1, 1 << 16, "px")
        check_range("delay", delay, 0, 60, "s")
        check_range("skip", skip, 0, 1000)
        check_range("timeout", timeout, 0.01, 600, "s")
        self.source, self.image_width = source, image_width
        self.delay, self.skip, self.timeout = delay, skip, timeout
        self._capture = _capture(source)
        self._is_file = isinstance(source, str) and Path(source).is_file()
        self._grabbing: _Grabbing | None = None
        try:
            self._set_size(width, height)
            if not self._is_file:
                self._hold(exposure, gain, focus, white_balance)
                self._grabbing = _Grabbing(self._capture)
                weakref.finalize(self, self._grabbing.end)
        except BaseException:
            self.close()
            raise

    def read(self) -> Image:
        """A grey image taken after the call, (height, width).

        Raises
        ------
        CameraFaultError
            If none comes in time.
        """
        frame = self._next_of_file() if self._grabbing is None else self._new(self._grabbing)
        return camera_image(_grey(frame, self.source), self.image_width, None, "The image")

    def close(self) -> None:
        """Let go of the camera."""
        if self._grabbing is not None:
            self._grabbing.end()
        self._capture.release()

    def _new(self, grabbing: _Grabbing) -> Any:
        frame = grabbing.arrivals.after(time.monotonic() + self.delay, self.skip, self.timeout)
        if frame is None:
            raise CameraFaultError(
                f"The camera {self.source!r} gave no image for {self.timeout:g} s; see that it is "
                "connected and that no other program uses it."
            )
        return frame

    def _next_of_file(self) -> Any:
        is_read, frame = self._capture.read()
        if not is_read:
            raise CameraFaultError(f"The video {self.source!r} has no further image.")
        return frame

    def _set_size(self, width: int | None, height: int | None) -> None:
        for key, value in ((cv2.CAP_PROP_FRAME_WIDTH, width), (cv2.CAP_PROP_FRAME_HEIGHT, height)):
            if value is None:
                continue
            self._capture.set(key, value)
            if (given := self._capture.get(key)) != value:
                raise CameraFaultError(
                    f"The camera {self.source!r} was asked for {value} px of "
                    f"{'width' if key == cv2.CAP_PROP_FRAME_WIDTH else 'height'}, but gives "
                    f"{given:g}; ask for a size that it has, or resize by image_width."
                )

    def _hold(
        self,
        exposure: float | None,
        gain: float | None,
        focus: float | None,
        white_balance: float | None,
    ) -> None:
        """Hold what the camera sets by itself, once it has seen a few images."""
        for _ in range(_SETTLING):
            if not self._capture.grab():
                break
        manual = _MANUAL_EXPOSURE.get(self._capture.getBackendName(), 0.0)
        is_held = {
            "exposure": self._holds(
                cv2.CAP_PROP_AUTO_EXPOSURE, manual, cv2.CAP_PROP_EXPOSURE, exposure
            ),
            "gain": gain is None or self._is_set(cv2.CAP_PROP_GAIN, gain),
            "focus": self._holds(cv2.CAP_PROP_AUTOFOCUS, 0.0, cv2.CAP_PROP_FOCUS, focus),
            "white balance": self._holds(
                cv2.CAP_PROP_AUTO_WB, 0.0, cv2.CAP_PROP_WB_TEMPERATURE, white_balance
            ),
        }
        if loose := [name for name in is_held if not is_held[name]]:
            warnings.warn(
                f"The camera {self.source!r} does not let its {listing(loose)} be held; if it has "
                "any that changes by itself, give a value such as exposure=100, or hold it with "
                "the program of its maker.",
                ServoscopeWarning,
                stacklevel=3,
            )

    def _holds(self, automatic: int, off: float, key: int, value: float | None) -> bool:
        """Whether the camera no longer changes something by itself.

        Where no value is asked for, and the image turns darker or brighter by a quarter once it is
        held, it is left to the camera.
        """
        before, brightness = self._capture.get(automatic), self._brightness()
        is_held = self._capture.set(automatic, off) and self._capture.get(automatic) == off
        if value is not None:
            return self._is_set(key, value) and is_held
        if is_held and abs(self._brightness() / brightness - 1) > _CHANGE:
            self._capture.set(automatic, before)
            return False
        return bool(is_held)

    def _brightness(self) -> float:
        for _ in range(BUFFERED):
            self._capture.grab()
        is_read, frame = self._capture.read()
        return 1.0 + float(np.mean(frame)) if is_read else float("nan")

    def _is_set(self, key: int, value: float) -> bool:
        is_taken = self._capture.set(key, value)
        return bool(is_taken and np.isclose(self._capture.get(key), value, rtol=0.1))


class _Grabbing:
    """A thread that takes every image of a camera.

    Parameters
    ----------
    capture : cv2.VideoCapture
    """

    def __init__(self, capture: Any) -> None:
        self.arrivals = Arrivals()
        self._capture, self._is_ended = capture, threading.Event()
        self._thread = threading.Thread(target=self._take, daemon=True)
        self._thread.start()

    def end(self) -> None:
        """End the thread."""
        self._is_ended.set()
        self._thread.join(1.0)

    def _take(self) -> None:
        n_failures = 0
        while not self._is_ended.is_set() and n_failures < _MOST_FAILURES:
            try:
                is_grabbed = self._capture.grab()
                if is_grabbed:
                    self.arrivals.put(self._frame)
            except cv2.error:
                is_grabbed = False
            n_failures = 0 if is_grabbed else n_failures + 1
            if not is_grabbed:
                time.sleep(_PAUSE)
        self.arrivals.end()

    def _frame(self) -> Any:
        is_read, frame = self._capture.retrieve()
        return frame if is_read else None


def _capture(source: int | str) -> Any:
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # it prints to standard error
    try:
        capture = cv2.VideoCapture(source)
    except cv2.error as error:
        raise CameraFaultError(f"OpenCV cannot open {source!r}: {one_line(error)}") from error
    if not capture.isOpened():
        raise CameraFaultError(
            f"OpenCV cannot open the camera {source!r}; see that it is connected and that no "
            "other program uses it. Cameras are numbered from 0."
        )
    return capture


def _grey(frame: Any, source: int | str) -> Image:
    if not isinstance(frame, np.ndarray) or frame.dtype != np.uint8 or not frame.size:
        raise CameraFaultError(
            f"The camera {source!r} must give images of 8 bits, got "
            f"{getattr(frame, 'dtype', type(frame).__name__)}; set its format."
        )
    if frame.ndim == 2 or frame.shape[2] == 1:
        return frame.reshape(frame.shape[:2]).copy()
    code = cv2.COLOR_BGRA2GRAY if frame.shape[2] == 4 else cv2.COLOR_BGR2GRAY
    return np.asarray(cv2.cvtColor(frame, code), dtype=np.uint8)
