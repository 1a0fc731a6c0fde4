"""A folder that another program fills with images."""

import threading
import time

import cv2
import numpy as np
import pytest

from servoscope.errors import CameraFaultError, InvalidInputError
from servoscope.robots.devices import open_camera
from servoscope.robots.folder_camera import FolderCamera


def png(level, dtype=np.uint8):
    return cv2.imencode(".png", np.full((6, 8), level, dtype))[1].tobytes()


NOISE = cv2.imencode(".png", np.random.default_rng(0).integers(0, 256, (30, 40)))[1].tobytes()


def later(call, seconds=0.1):
    timer = threading.Timer(seconds, call)
    timer.start()
    return timer


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "old.png").write_bytes(png(1))
    return tmp_path


def test_an_image_appears_after_the_call(folder):
    camera = open_camera(f"folder:{folder}?timeout=3")
    for n in range(2, 4):
        later(lambda n=n: (folder / f"{n}.png").write_bytes(png(n)))
        assert (camera.read() == n).all()


def test_a_file_is_awaited_until_it_is_whole(folder):
    content = png(9)

    def write():
        with open(folder / "slow.png", "wb", buffering=0) as file:
            for start in range(0, len(content), 30):
                file.write(content[start : start + 30])
                time.sleep(0.03)

    later(write)
    assert (FolderCamera(folder).read() == 9).all()


def test_a_file_that_was_begun_before_the_call_is_not_taken(folder):
    (folder / "half.png").write_bytes(png(5)[:20])
    later(lambda: (folder / "half.png").write_bytes(png(5)))
    with pytest.raises(CameraFaultError, match=r"within 0\.4 s; .* of a new name"):
        FolderCamera(folder, timeout=0.4).read()


def test_other_files_and_broken_ones_are_passed_over(folder):
    (folder / "notes.txt").touch()
    later(lambda: (folder / "notes2.txt").write_text("no image"))
    later(lambda: (folder / "broken.png").write_bytes(NOISE[:-100]))
    with pytest.raises(CameraFaultError, match=r"broken\.png is not a whole image") as caught:
        FolderCamera(folder, timeout=0.5).read()
    assert len(str(caught.value).splitlines()) == 1


def test_deep_images_need_their_bits(folder):
    def write():
        (folder / f"{time.monotonic_ns()}.png").write_bytes(png(4080, np.uint16))

    later(write)
    with pytest.raises(CameraFaultError, match="bit_depth=12"):
        FolderCamera(folder).read()
    later(write)
    assert (open_camera(f"folder:{folder}?bit_depth=12&image_width=4").read() == 255).all()


@pytest.mark.parametrize("options", ["", "?delay=-1", "?bit_depth=7", "?image_width=0", "?x=1"])
def test_options_of_no_sense_are_refused(folder, options):
    where = folder if options else folder / "none"
    with pytest.raises(InvalidInputError):
        open_camera(f"folder:{where}{options}")
