"""The free camera goes where it is sent, but for the stated error."""

import numpy as np
import pytest

from servoscope.errors import InvalidInputError
from servoscope.poses import displacements_from_poses, is_rigid, pose_error, rigid_transform
from servoscope.robots.free_camera import FreeCamera, Repeatability
from servoscope.scene.scene import T_WORLD_REF, Scene

SCENE = Scene(image_size=16)


def _errors(repeatability: Repeatability, n: int) -> np.ndarray:
    camera = FreeCamera(SCENE, repeatability=repeatability, rng=np.random.default_rng(0))
    reached = []
    for _ in range(n):
        camera.move_to(T_WORLD_REF)
        reached.append(camera.true_pose)
    return displacements_from_poses(T_WORLD_REF, np.stack(reached), pivot=0.0)


def test_errors_are_normal_with_the_stated_deviations() -> None:
    from scipy.stats import kstest

    errors = _errors(Repeatability(position=2e-4, rotation=1e-3), 4000)
    np.testing.assert_allclose(errors.std(axis=0), [2e-4] * 3 + [1e-3] * 3, rtol=0.05)
    np.testing.assert_allclose(errors.mean(axis=0) / errors.std(axis=0), 0, atol=0.06)
    scaled = errors / ([2e-4] * 3 + [1e-3] * 3)
    assert all(kstest(column, "norm").pvalue > 1e-3 for column in scaled.T)
    assert np.abs(np.corrcoef(errors.T) - np.eye(6)).max() < 0.06


def test_without_an_error_every_pose_is_reached_exactly() -> None:
    assert (np.abs(_errors(Repeatability(), 3)) < 1e-12).all()
    camera = FreeCamera(SCENE, repeatability=Repeatability(1e-3, 1e-2))
    camera.move_to(T_WORLD_REF)
    np.testing.assert_array_equal(camera.true_pose, T_WORLD_REF)


def test_pose_is_the_commanded_one_and_the_image_is_of_the_true_one() -> None:
    repeatability = Repeatability(position=0.01, rotation=0.05)
    camera = FreeCamera(SCENE, repeatability=repeatability, rng=np.random.default_rng(0))
    camera.move_to(T_WORLD_REF)
    np.testing.assert_array_equal(camera.pose, T_WORLD_REF)
    assert is_rigid(camera.true_pose)
    image = camera.read().astype(int)
    there, here = (FreeCamera(SCENE, T).read() for T in (camera.true_pose, camera.pose))
    assert np.abs(image - there).mean() < 0.5 * np.abs(image - here).mean()


def test_moves_are_in_the_frame_of_the_camera_and_add_up() -> None:
    camera = FreeCamera(SCENE)
    for _ in range(2):
        camera.move(rigid_transform(np.eye(3), [0.01, 0.02, 0.05]))
    np.testing.assert_allclose(camera.pose[:3, 3], [0.02, -0.04, 0.45], atol=1e-12)


def test_a_move_is_believed_to_be_the_one_that_was_commanded() -> None:
    camera = FreeCamera(SCENE, repeatability=Repeatability(1e-3), rng=np.random.default_rng(0))
    displacement = rigid_transform(np.diag([-1.0, -1.0, 1.0]), [0.01, 0.02, 0.05])
    executed = camera.move(displacement)
    np.testing.assert_array_equal(executed, displacement)
    executed[:] = 0
    np.testing.assert_allclose(camera.pose, T_WORLD_REF @ displacement, atol=1e-12)


def test_errors_of_motion_do_not_pile_up() -> None:
    repeatability = Repeatability(position=1e-3)
    camera = FreeCamera(SCENE, repeatability=repeatability, rng=np.random.default_rng(0))
    for _ in range(500):
        camera.move(np.eye(4))
    distance, _ = pose_error(camera.true_pose, T_WORLD_REF)
    assert distance < 5e-3


def test_poses_handed_out_and_in_are_copies() -> None:
    start = T_WORLD_REF.copy()
    camera = FreeCamera(SCENE, start)
    camera.pose[:] = 0
    camera.true_pose[:] = 0
    start[:] = 0
    np.testing.assert_array_equal(camera.pose, T_WORLD_REF)
    np.testing.assert_array_equal(camera.true_pose, T_WORLD_REF)


@pytest.mark.parametrize("value", [-1.0, np.nan, np.inf])
@pytest.mark.parametrize("name", ["position", "rotation"])
def test_impossible_errors_are_refused(name: str, value: float) -> None:
    with pytest.raises(InvalidInputError, match=f"{name} must be finite and not negative"):
        Repeatability(**{name: value})


@pytest.mark.parametrize("bad", [np.eye(3), np.full((4, 4), np.nan), 2 * np.eye(4), "there"])
def test_it_is_sent_to_rigid_transforms_only(bad) -> None:
    camera = FreeCamera(SCENE)
    with pytest.raises(InvalidInputError, match="T_world_cam must"):
        camera.move_to(bad)
    with pytest.raises(InvalidInputError, match="displacement must"):
        camera.move(bad)
    np.testing.assert_array_equal(camera.pose, T_WORLD_REF)
