"""Robots and cameras that are opened by name, of kinds that are known and of one's own modules."""

import sys

import numpy as np
import pytest

from planar import planar_data_set
from servoscope.errors import InvalidInputError, PluginError, RobotFaultError, ServoscopeError
from servoscope.plugins import Registry
from servoscope.robots import devices
from servoscope.robots.devices import open_both, open_camera, open_robot
from servoscope.robots.options import split_options

CELL = """
import numpy as np
from servoscope.errors import RobotFaultError

class Arm:
    made = 0

    def __init__(self):
        Arm.made += 1

    @property
    def pose(self):
        raise OSError("asked too early")

    def move_to(self, pose): pass
    def stop(self): pass

class Old:
    pose = np.eye(4)
    def move(self, displacement): return displacement

class Eye:
    def read(self):
        return np.zeros((4, 6), np.uint8)

class Both(Old, Eye): pass

def arm():
    return Arm()

def far(): raise RobotFaultError("The arm at 192.0.2.7 does not answer.")
def broken(): raise OSError("no\\nsuch port")
def leaving(): raise SystemExit(3)
def needs(port): return port
number = 3
"""


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A current folder with modules that nothing has imported."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    (tmp_path / "mycell.py").write_text(CELL)
    (tmp_path / "torn.py").write_text("import no_such_driver")
    yield tmp_path
    for name in ("mycell", "torn"):
        sys.modules.pop(name, None)


def test_a_class_or_a_function_of_the_current_folder_makes_the_device(here):
    assert type(open_robot("mycell:Arm")).__name__ == "Arm"
    assert type(open_robot("mycell:arm")).__name__ == "Arm"
    assert open_robot("mycell:Old").pose.shape == (4, 4)
    assert open_camera("mycell:Eye").read().shape == (4, 6)


def test_a_robot_that_takes_images_is_its_own_camera_and_opened_once(here):
    for camera in (None, "mycell:Both"):
        robot, eye = open_both("mycell:Both", camera)
        assert robot is eye
    robot, eye = open_both("mycell:Arm", "mycell:Eye")
    assert (type(robot).__name__, type(eye).__name__) == ("Arm", "Eye")
    with pytest.raises(InvalidInputError, match="gives no images; say which camera"):
        open_both("mycell:Arm", None)


@pytest.mark.parametrize(
    ("spec", "kind", "said"),
    [
        ("legs", InvalidInputError, r"must be .*recorded:FOLDER.* or module:Class.*got 'legs'"),
        ("", InvalidInputError, "got ''"),
        ("recorded", InvalidInputError, "got 'recorded'"),
        ("recorded:", InvalidInputError, "got 'recorded:'"),
        ("no_such_module:Arm", InvalidInputError, "there is no module 'no_such_module'"),
        ("../mycell:Arm", InvalidInputError, "got '../mycell:Arm'"),
        ("mycell:Legs", InvalidInputError, "has no 'Legs'"),
        ("mycell:Eye", InvalidInputError, "property `pose` and a method"),
        ("mycell:number", InvalidInputError, "got one of type int"),
        ("mycell:needs", PluginError, "without arguments"),
        ("mycell:broken", PluginError, "OSError: no such port"),
        ("mycell:leaving", PluginError, "SystemExit: 3"),
        ("torn:Arm", PluginError, "No module named 'no_such_driver'"),
        ("mycell:far", RobotFaultError, "does not answer"),
    ],
)
def test_what_cannot_be_opened_says_why_in_a_line(here, spec, kind, said):
    with pytest.raises(kind, match=said) as caught:
        open_robot(spec)
    assert isinstance(caught.value, ServoscopeError)
    assert len(str(caught.value).splitlines()) == 1


def test_a_camera_must_be_readable(here):
    with pytest.raises(InvalidInputError, match=r"must have a method `read\(\)`"):
        open_camera("mycell:Old")


def test_a_data_set_is_robot_and_camera(tmp_path):
    data = planar_data_set(16, 12)
    data.save(tmp_path / "data")
    robot, camera = open_both(f"recorded:{tmp_path / 'data'}", None)
    assert camera is robot
    np.testing.assert_array_equal(robot.pose, data.T_world_cam[0])
    np.testing.assert_array_equal(camera.read(), data.images[0])


def test_a_kind_is_one_line_of_the_registry(monkeypatch):
    kinds = Registry("servoscope.none", {"echo": devices.Kind("echo:TEXT", Echo)}, None)
    monkeypatch.setattr(devices, "CAMERA_KINDS", kinds)
    assert open_camera("echo:a:b?c").text == "a:b?c"
    with pytest.raises(InvalidInputError, match="must be echo:TEXT or module:Class"):
        open_camera("ech:a-b")


class Echo:
    def __init__(self, text):
        self.text = text

    def read(self):
        return np.zeros((2, 2), np.uint8)


def test_options_stand_behind_a_question_mark():
    types = {"width": int, "gain": float}
    assert split_options("0", types) == ("0", {})
    assert split_options("a?width=3&gain=-1.5", types) == ("a", {"width": 3, "gain": -1.5})
    assert split_options("a?width=3,gain=2", types) == ("a", {"width": 3, "gain": 2.0})
    query = "rtsp://h/live?channel=1"
    assert split_options(query, types) == (query, {})
    assert split_options(f"{query}?width=3", types) == (query, {"width": 3})
    for text, said in (("0?size=3", "width and gain, got 'size'"), ("0?width=x", "no value 'x'")):
        with pytest.raises(InvalidInputError, match=said):
            split_options(text, types)
