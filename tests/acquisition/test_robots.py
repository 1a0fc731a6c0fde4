"""Acquisition by robots that report another frame than the camera's and cannot go everywhere."""

from pathlib import Path

import numpy as np
import pytest

from servoscope.acquisition import AcquisitionConfig, acquire
from servoscope.data.images import PoseImageSet
from servoscope.errors import RobotFaultError
from servoscope.poses import (
    displacements_from_poses,
    inverse_transform,
    pose_error,
    rigid_transform,
)
from servoscope.robots.free_camera import FreeCamera
from servoscope.robots.registry import ROBOTS, make_robot
from servoscope.scene.scene import T_WORLD_REF

SETTINGS = {"image_size": 16, "seed": 2, "part": "textured_plane"}
MOUNT = rigid_transform(np.eye(3), [0.03, 0.0, 0.05])
ENCODER = rigid_transform(np.eye(3), [0.0, 0.0, 1e-4])


class Crane:
    """Reports the pose of its hook, 0.1 mm off from where it was sent; cannot go to negative rz."""

    def __init__(self, scene, T_world_cam, repeatability, rng):
        self.camera = FreeCamera(scene, T_world_cam, repeatability, rng)
        self.hook = T_world_cam @ inverse_transform(MOUNT)

    @property
    def pose(self):
        return self.hook

    @property
    def true_pose(self):
        return self.camera.true_pose

    def move_to(self, pose):
        self.camera.move_to(pose @ MOUNT)  # it swings before it is seen to be too far
        self.hook = pose @ ENCODER
        if displacements_from_poses(T_WORLD_REF @ inverse_transform(MOUNT), pose, 0.6)[5] < 0:
            raise RobotFaultError("too far")

    def read(self):
        return self.camera.read()


@pytest.fixture
def crane(monkeypatch: pytest.MonkeyPatch) -> AcquisitionConfig:
    """A config with a robot that one line has made known."""
    monkeypatch.setitem(ROBOTS.built_in, "crane", Crane)
    return AcquisitionConfig(schedule=((30, 1.0), (30, 0.2)), robot="crane", **SETTINGS)


def test_poses_out_of_reach_are_drawn_anew_in_their_ring(
    tmp_path: Path, crane: AcquisitionConfig
) -> None:
    data = acquire(tmp_path, crane, n_jobs=1)
    assert len(data) == 60
    scaled = data.delta_p() / np.array([0.025] * 3 + [np.radians(15)] * 3)
    assert (scaled[:, 5] >= 0).all()
    assert 0.7 < np.abs(scaled[:30]).max() <= 1.01
    assert 0.14 < np.abs(scaled[30:]).max() <= 0.21
    assert len(np.unique(scaled.round(9), axis=0)) == 60
    assert 30 < data.source["n_replaced"] < 120  # every second draw fails
    kept = crane.displacements()[:, 5] >= 0
    asked = crane.poses()[kept] @ ENCODER
    np.testing.assert_allclose(data.T_world_cam[kept], asked, atol=1e-12)


def test_the_reported_frame_is_the_one_that_is_stored(
    tmp_path: Path, crane: AcquisitionConfig
) -> None:
    data = acquire(tmp_path, crane, n_jobs=1)
    np.testing.assert_allclose(data.T_world_ref @ MOUNT, T_WORLD_REF, atol=1e-12)
    assert data.pivot == pytest.approx(0.60)  # 550 mm before a camera 50 mm ahead of the hook


def test_an_interrupted_acquisition_ends_with_the_same_poses_and_count(
    tmp_path: Path, crane: AcquisitionConfig
) -> None:
    def stop(_: int) -> None:
        raise KeyboardInterrupt

    whole = acquire(tmp_path / "whole", crane, n_jobs=1)
    for _ in range(3):
        with pytest.raises(KeyboardInterrupt):
            acquire(tmp_path / "parts", crane, n_jobs=1, on_progress=stop)
    parts = acquire(tmp_path / "parts", crane, n_jobs=1)
    np.testing.assert_array_equal(parts.images, whole.images)
    np.testing.assert_array_equal(parts.T_world_cam, whole.T_world_cam)
    assert parts.source == whole.source


def test_a_robot_that_can_go_nowhere_is_reported(
    tmp_path: Path, crane: AcquisitionConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise RobotFaultError("rusted")

    monkeypatch.setattr(Crane, "move_to", refuse)
    with pytest.raises(RobotFaultError, match=r"none of 100 poses drawn for image 0 \(rusted\)"):
        acquire(tmp_path, crane, n_jobs=1)


def test_what_is_no_refusal_is_not_drawn_anew(
    tmp_path: Path, crane: AcquisitionConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(Crane, "move_to", fail)
    with pytest.raises(ZeroDivisionError):
        acquire(tmp_path, crane, n_jobs=1)


ARM = AcquisitionConfig(schedule=((27, 4.0), (6, 0.1)), robot="arm", **SETTINGS)


@pytest.fixture(scope="module")
def by_arm(tmp_path_factory: pytest.TempPathFactory) -> PoseImageSet:
    """Images that the arm takes in one process."""
    pytest.importorskip("mujoco")
    return acquire(tmp_path_factory.mktemp("arm"), ARM, n_jobs=1)


def test_the_arms_poses_are_those_that_it_reports(by_arm: PoseImageSet) -> None:
    first, last = 0, len(by_arm) - 1
    for i in (first, last):
        robot = make_robot("arm", ARM.scene(), ARM.repeatability(), ARM.camera_rng(i))
        robot.move_to(ARM.poses()[i])
        np.testing.assert_allclose(robot.pose, by_arm.T_world_cam[i], atol=1e-12)
        np.testing.assert_array_equal(robot.read(), by_arm.images[i])
        distance, _ = pose_error(robot.pose, ARM.poses()[i])
        assert 0 < distance < 1e-3  # the encoders do not read what was asked for


def test_the_arms_displacements_lie_in_their_rings(by_arm: PoseImageSet) -> None:
    scaled = by_arm.delta_p() / np.array([0.025] * 3 + [np.radians(15)] * 3)
    assert 2.5 < np.abs(scaled[:27]).max() < 4.01
    assert 0.06 < np.abs(scaled[27:]).max() < 0.101
    assert by_arm.source["n_replaced"] > 0
    assert by_arm.source["robot"] == "arm"


def test_the_arms_camera_starts_at_the_reference_of_the_free_one(by_arm: PoseImageSet) -> None:
    free = FreeCamera(ARM.scene()).read().astype(int)
    assert np.abs(by_arm.reference_image - free).mean() < 2
    assert np.linalg.norm(by_arm.T_world_ref[:3, 3] - T_WORLD_REF[:3, 3]) > 0.03


def test_the_part_stays_in_the_arms_view() -> None:
    pytest.importorskip("mujoco")
    config = AcquisitionConfig(schedule=((500, 1.6),), robot="arm")
    T_flange_cam = inverse_transform(config.reference()) @ T_WORLD_REF
    x, y, z = (inverse_transform(config.poses() @ T_flange_cam) @ [0, 0, 0, 1.0])[:, :3].T
    assert (np.hypot(x, y) / z).max() < 0.5 / config.scene().lens.focal_length


@pytest.mark.slow
def test_arms_in_two_processes_give_the_images_of_one(tmp_path: Path, by_arm: PoseImageSet) -> None:
    data = acquire(tmp_path, ARM, n_jobs=2)
    np.testing.assert_array_equal(data.images, by_arm.images)
    np.testing.assert_array_equal(data.T_world_cam, by_arm.T_world_cam)
    assert data.source == by_arm.source
