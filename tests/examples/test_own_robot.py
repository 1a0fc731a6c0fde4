"""The example's camera, robot and images, with a simulated robot for a driver."""

import importlib.util
from pathlib import Path

import cv2
import numpy as np
import pytest

import servoscope as sv
from planar import PIVOT, planar_images
from servoscope.poses import displacements_from_poses, pose_error, rigid_transform

SCRIPT = Path(__file__).parents[2] / "examples" / "own_robot.py"


@pytest.fixture(scope="module")
def example():
    spec = importlib.util.spec_from_file_location("own_robot", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Driver:
    """What commands the robot of a cell, by poses."""

    def __init__(self) -> None:
        self.T, self.stopped = rigid_transform(np.diag([1.0, -1.0, -1.0]), [0.1, 0.2, 0.6]), False

    def get_pose(self):
        return self.T.copy()

    def move_linear(self, T) -> None:
        self.T = np.array(T)

    def stop(self) -> None:
        self.stopped = True


class Video:
    def __init__(self, frame) -> None:
        self.frame, self.n_read = frame, 0

    def read(self):
        self.n_read += 1
        return self.frame is not None, self.frame


def test_the_robot_goes_where_it_is_sent_and_stops(example) -> None:
    driver = Driver()
    robot = example.MyRobot(driver)
    target = robot.pose @ rigid_transform(np.eye(3), [0.0, 0.0, 0.05])
    robot.move_to(target)
    np.testing.assert_array_equal(robot.pose, target)
    robot.stop()
    assert driver.stopped


def test_the_camera_gives_the_newest_grey_middle(example, monkeypatch) -> None:
    frame = np.zeros((120, 200, 3), np.uint8)
    frame[:, 40:160] = 90
    video = Video(frame)
    monkeypatch.setattr(cv2, "VideoCapture", lambda device: video)
    image = example.MyCamera(size=60).read()
    assert image.shape == (60, 60)
    assert image.dtype == np.uint8
    assert (image == 90).all()
    assert video.n_read == 3
    video.frame = None
    with pytest.raises(RuntimeError, match="no image"):
        example.MyCamera().read()


def test_images_are_taken_around_the_reference_and_the_robot_comes_back(example, tmp_path) -> None:
    driver = Driver()
    robot = example.MyRobot(driver)
    start = robot.pose

    class Camera:
        def read(self):
            delta_p = displacements_from_poses(start, driver.T[None], PIVOT)
            return planar_images(delta_p, 32, seed=1)[0]

    options = {"translation_mm": 10, "rotation_deg": 5, "pivot_mm": 1e3 * PIVOT, "n_images": 20}
    data = sv.acquire_from(robot, Camera(), tmp_path / "part", **options)
    assert isinstance(data, sv.PoseImageSet)
    assert len(data) == 20
    assert max(pose_error(robot.pose, start)) < 1e-7
    assert driver.stopped
    assert 0.5 < np.abs(data.delta_p() / data.ranges()).max() <= 1 + 1e-9
