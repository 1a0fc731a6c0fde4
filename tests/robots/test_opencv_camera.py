"""Cameras of OpenCV: a stand-in of its capture with buffers, and a video file that it wrote."""

import threading
import time
import warnings
from typing import ClassVar

import cv2
import numpy as np
import pytest

from servoscope.errors import CameraFaultError, InvalidInputError, ServoscopeWarning
from servoscope.robots.devices import open_camera
from servoscope.robots.opencv_camera import OpenCVCamera

INTERVAL = 0.004


class Capture:
    """A camera of 250 images a second that exposes one while the one before is sent.

    Its driver keeps up to three images that nobody took. What it sees is `world`.
    """

    world = 50
    backend = "V4L2"
    has_automatics = True
    opened: ClassVar[list] = []
    stale_exposure = False
    is_dead = False

    def __init__(self, source):
        self.source, self.is_released = source, False
        self.values = {cv2.CAP_PROP_AUTO_EXPOSURE: 3.0, cv2.CAP_PROP_AUTOFOCUS: 1.0}
        self.values |= {cv2.CAP_PROP_AUTO_WB: 1.0, cv2.CAP_PROP_EXPOSURE: 156.0}
        self.values |= {cv2.CAP_PROP_FRAME_WIDTH: 640.0, cv2.CAP_PROP_FRAME_HEIGHT: 480.0}
        self._buffered, self._changed = [], threading.Condition()
        self._level = None
        self.opened.append(self)
        threading.Thread(target=self._expose, daemon=True).start()

    def _expose(self):
        sent = None
        while not self.is_released:
            begun = type(self).world  # what is seen when the exposure begins
            time.sleep(INTERVAL)
            with self._changed:
                if sent is not None and not self.is_dead:
                    self._buffered = [*self._buffered, sent][:3]
                    self._changed.notify_all()
            sent = begun

    def isOpened(self):
        return self.source != 9

    def getBackendName(self):
        return self.backend

    def get(self, key):
        return self.values.get(key, -1.0)

    def set(self, key, value):
        if key in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT):
            value = min(value, 1280.0)
        elif not self.has_automatics or key not in self.values:
            return False
        self.values[key] = float(value)
        return True

    def grab(self):
        with self._changed:
            if not self._changed.wait_for(lambda: self._buffered, 0.02):
                return False
            self._level = self._buffered.pop(0)
        return True

    def retrieve(self):
        dark = self.stale_exposure and self.values[cv2.CAP_PROP_AUTO_EXPOSURE] == 1.0
        frame = np.full((48, 64, 3), self._level // (3 if dark else 1), np.uint8)
        return True, frame

    def read(self):
        return self.retrieve() if self.grab() else (False, None)

    def release(self):
        self.is_released = True


@pytest.fixture
def capture(monkeypatch):
    kind = type("OneCapture", (Capture,), {"opened": []})
    monkeypatch.setattr(cv2, "VideoCapture", kind)
    yield kind
    for one in kind.opened:  # a camera that was refused is released when nobody holds it any more
        one.release()


def test_an_image_is_taken_after_the_call(capture):
    camera = open_camera("opencv:0?timeout=2")
    levels = []
    for level in range(60, 120, 3):
        capture.world = level  # the robot has moved
        levels.append(int(camera.read()[0, 0]))
        time.sleep(INTERVAL * (level % 4))
    assert levels == list(range(60, 120, 3))
    camera.close()


def test_a_camera_with_a_delay_is_waited_for(capture):
    camera = OpenCVCamera(0, delay=0.1)
    begin = time.monotonic()
    camera.read()
    assert time.monotonic() - begin > 0.1
    camera.close()


def test_what_changes_by_itself_is_held(capture):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        camera = open_camera("opencv:0?exposure=90")
    values = camera._capture.values
    assert values[cv2.CAP_PROP_AUTO_EXPOSURE] == 1.0
    assert values[cv2.CAP_PROP_EXPOSURE] == 90.0
    assert values[cv2.CAP_PROP_AUTOFOCUS] == values[cv2.CAP_PROP_AUTO_WB] == 0.0
    camera.close()


def test_what_cannot_be_held_is_named(capture):
    capture.has_automatics = False
    with pytest.warns(ServoscopeWarning, match="its exposure, gain, focus and white balance be"):
        OpenCVCamera(0, gain=3.0).close()


def test_an_exposure_that_darkens_the_image_is_left_to_the_camera(capture):
    capture.stale_exposure = True
    with pytest.warns(ServoscopeWarning, match="its exposure be held"):
        camera = OpenCVCamera(0)
    assert camera._capture.values[cv2.CAP_PROP_AUTO_EXPOSURE] == 3.0
    camera.close()


def test_a_size_that_the_camera_has_not_is_refused(capture):
    camera = OpenCVCamera(0, width=800, height=600)
    assert camera._capture.values[cv2.CAP_PROP_FRAME_WIDTH] == 800
    camera.close()
    with pytest.raises(CameraFaultError, match="asked for 1920 px of width, but gives 1280"):
        OpenCVCamera(0, width=1920)


def test_images_are_resized_as_an_import_does(capture):
    camera = open_camera("opencv:0?image_width=32")
    assert camera.read().shape == (24, 32)
    camera.close()


def test_a_camera_that_falls_silent_says_so_in_a_line(capture):
    camera = OpenCVCamera(0, timeout=0.5)
    camera.read()
    capture.is_dead = True
    with pytest.raises(CameraFaultError, match=r"gave no image for 0\.5 s") as caught:
        camera.read()
    assert len(str(caught.value).splitlines()) == 1
    camera.close()
    assert camera._capture.is_released


def test_a_camera_that_is_not_there_says_so(capture):
    with pytest.raises(CameraFaultError, match="cannot open the camera 9"):
        open_camera("opencv:9")


@pytest.mark.parametrize("options", ["width=0", "delay=-1", "timeout=nan", "size=3"])
def test_options_of_no_sense_are_refused(capture, options):
    with pytest.raises(InvalidInputError):
        open_camera(f"opencv:0?{options}")


def test_a_video_file_is_read_image_by_image(tmp_path):
    path = str(tmp_path / "film.avi")
    writer = cv2.VideoWriter(path, cv2.VideoWriter.fourcc(*"MJPG"), 10, (64, 48))
    for level in (40, 120, 200):
        writer.write(np.full((48, 64, 3), level, np.uint8))
    writer.release()
    camera = open_camera(f"opencv:{path}")
    images = [camera.read() for _ in range(3)]
    assert [image.shape for image in images] == [(48, 64)] * 3
    np.testing.assert_allclose([image.mean() for image in images], [40, 120, 200], atol=2)
    with pytest.raises(CameraFaultError, match="no further image"):
        camera.read()


def test_colour_turns_grey_as_in_files(capture, monkeypatch, rng):
    from PIL import Image

    frame = rng.integers(0, 256, (48, 64, 3), dtype=np.uint8)
    monkeypatch.setattr(capture, "retrieve", lambda self: (True, frame))
    camera = OpenCVCamera(0)
    expected = np.asarray(Image.fromarray(frame[..., ::-1]).convert("L"), dtype=int)
    assert np.abs(camera.read() - expected).max() <= 1
    camera.close()
