"""Cameras of GigE Vision and USB3 Vision, through the GenTL producer of their maker."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import (
    CameraFaultError,
    DataSetError,
    InvalidInputError,
    ServoscopeError,
    ServoscopeWarning,
)
from servoscope.formats.ros_images import RAW, grey_of_message
from servoscope.robots.camera_image import camera_image
from servoscope.robots.options import check_range, split_options
from servoscope.storage.reading import without_advice
from servoscope.wording import listing, one_line

OPTIONS: dict[str, Callable[[str], Any]] = {
    "serial": str,
    "exposure": float,
    "gain": float,
    "image_width": int,
    "timeout": float,
}
"""Of ``gentl:PRODUCER.cti?name=value``."""

ENCODINGS = {
    "Mono8": ("mono8", 8),
    "Mono10": ("mono16", 10),
    "Mono12": ("mono16", 12),
    "Mono14": ("mono16", 14),
    "Mono16": ("mono16", 16),
    "RGB8": ("rgb8", 8),
    "BGR8": ("bgr8", 8),
    "BayerRG8": ("bayer_rggb8", 8),
    "BayerBG8": ("bayer_bggr8", 8),
    "BayerGB8": ("bayer_gbrg8", 8),
    "BayerGR8": ("bayer_grbg8", 8),
}
"""Pixel formats that are read, as ROS calls them, and the bits that they fill."""

_AUTOMATICS = {"ExposureAuto": "exposure", "GainAuto": "gain", "BalanceWhiteAuto": "white balance"}


def gentl_camera(text: str) -> GenTLCamera:
    """The camera that is written ``gentl:PRODUCER.cti?name=value``, without the kind."""
    producer, options = split_options(text, OPTIONS)
    return GenTLCamera(producer, **options)


class GenTLCamera:
    """A camera that a GenTL producer knows.

    It takes images only while it is read, so that none can be older than the call. What it sets by
    itself (exposure, gain, white balance) is switched off when it is opened.

    Parameters
    ----------
    producer : path-like
        File of the camera's maker, ``.cti``.
    serial : str, optional
        Serial number, where the producer knows several cameras.
    exposure : float, optional
        [us]; by default as it is set on the camera.
    gain : float, optional
        In the unit of the camera.
    image_width : int, optional
        Width that images are resized to, as `servoscope import` does, [px].
    timeout : float
        How long an image may take, [s].

    Raises
    ------
    ServoscopeError
        If ``harvesters`` is not installed.
    InvalidInputError
        If a number is not of its range, or there is no such file.
    CameraFaultError
        If the camera cannot be opened, or does not take a value that is asked for.

    Warns
    -----
    ServoscopeWarning
        If something that the camera sets by itself cannot be switched off.
    """

    def __init__(
        self,
        producer: str | Path,
        *,
        serial: str | None = None,
        exposure: float | None = None,
        gain: float | None = None,
        image_width: int | None = None,
        timeout: float = 5.0,
    ) -> None:
        check_range("image_width", image_width, 1, 1 << 16, "px")
        check_range("timeout", timeout, 0.01, 600, "s")
        if not Path(producer).is_file():
            raise InvalidInputError(
                f"The producer must be a .cti file of the camera's maker, got {str(producer)!r}."
            )
        self.image_width, self.timeout = image_width, timeout
        self._harvester = _harvester()
        self._acquirer: Any = None
        try:
            self._harvester.add_file(str(producer))
            self._harvester.update()
            self._acquirer = self._harvester.create(_key(self._harvester, serial))
        except Exception as error:
            self.close()
            raise CameraFaultError(
                f"No camera could be opened with {producer} ({one_line(error)}); see that it is "
                "connected and that no other program uses it."
            ) from error
        try:
            self._set_up(exposure, gain)
        except BaseException:
            self.close()
            raise

    def read(self) -> NDArray[np.uint8]:
        """A grey image taken after the call, (height, width).

        Raises
        ------
        CameraFaultError
            If none comes in time, or it has a format that is not read.
        """
        try:
            self._acquirer.start()
            try:
                with self._acquirer.fetch(timeout=self.timeout) as buffer:
                    return self._image(buffer.payload.components[0])
            finally:
                self._acquirer.stop()
        except ServoscopeError:
            raise
        except Exception as error:
            raise CameraFaultError(
                f"The camera gave no image within {self.timeout:g} s ({one_line(error)}); see its "
                "cable, and that it is not waiting for a trigger."
            ) from error

    def close(self) -> None:
        """Let go of the camera."""
        if self._acquirer is not None:
            self._acquirer.destroy()
            self._acquirer = None
        self._harvester.reset()

    def _image(self, component: Any) -> NDArray[np.uint8]:
        kind = str(component.data_format)
        if kind not in ENCODINGS:
            raise CameraFaultError(
                f"The pixel format must be {', '.join(ENCODINGS)}, but the camera gives {kind}; "
                "set another with its maker's program."
            )
        encoding, bits = ENCODINGS[kind]
        data = np.array(component.data).view(np.uint8).ravel()
        height, width = int(component.height), int(component.width)
        fields = SimpleNamespace(
            height=height, width=width, encoding=encoding, is_bigendian=0,
            step=data.size // max(1, height), data=data,
        )  # fmt: skip
        try:
            levels = grey_of_message(fields, RAW, "The image")
        except DataSetError as error:
            raise CameraFaultError(f"{without_advice(error)}.") from error
        return camera_image(levels, self.image_width, bits, "The image")

    def _set_up(self, exposure: float | None, gain: float | None) -> None:
        """Switch off what the camera sets by itself, and set what is asked for."""
        nodes = self._acquirer.remote_device.node_map
        loose = [what for name, what in _AUTOMATICS.items() if not _is_set(nodes, name, "Off")]
        if loose:
            warnings.warn(
                f"The camera does not let its {listing(loose)} be held; if it changes by itself, "
                "hold it with the program of the camera's maker.",
                ServoscopeWarning,
                stacklevel=4,
            )
        _is_set(nodes, "PixelFormat", "Mono8")
        for name, value in (("ExposureTime", exposure), ("Gain", gain)):
            if value is not None and not _is_set(nodes, name, value):
                raise CameraFaultError(
                    f"The camera does not take {value:g} for {name}; see its range in the program "
                    "of its maker."
                )


def _is_set(nodes: Any, name: str, value: Any) -> bool:
    """Whether a feature has a value now; a camera without the feature needs none."""
    node = getattr(nodes, name, None)
    if node is None:
        return isinstance(value, str)
    try:
        node.value = value
        return bool(
            node.value == value
            if isinstance(value, str)
            else np.isclose(node.value, value, rtol=0.05)
        )
    except Exception:  # bindings raise of every kind where a feature is not writable
        return False


def _key(harvester: Any, serial: str | None) -> Any:
    if serial is not None:
        return {"serial_number": serial}
    n = len(harvester.device_info_list)
    if n > 1:
        known = [str(info.serial_number) for info in harvester.device_info_list]
        raise ValueError(f"there are {n}, name one by serial={' or '.join(known)}")
    return 0


def _harvester() -> Any:
    try:
        from harvesters.core import Harvester
    except ImportError as error:
        raise ServoscopeError(
            "Cameras of GigE Vision and USB3 Vision need harvesters; install it with: pip install "
            '"servoscope[gentl]".'
        ) from error
    return Harvester()
