"""The arm in physics: what it executes, what it refuses, and what it repeats."""

import sys
from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from servoscope.errors import InvalidInputError, RobotFaultError, ServoscopeError
from servoscope.poses import (
    inverse_transform,
    pose_error,
    poses_from_displacements,
    rigid_transform,
)
from servoscope.processes import in_processes
from servoscope.robots.free_camera import FreeCamera, Repeatability
from servoscope.scene.scene import T_WORLD_REF, Scene
from servoscope.scene.textured_plane import TexturedPlane

mujoco = pytest.importorskip("mujoco", reason="the arm needs MuJoCo, the extra `arm`")
from servoscope.robots.arm import LIMITS, MOUNT, READY, T_WORLD_BASE, Arm  # noqa: E402
from servoscope.robots.arm_kinematics import flange_pose  # noqa: E402

SCENE = Scene(image_size=16, part=TexturedPlane())
HEAD = Scene(image_size=16)
RANGES = np.array([0.025] * 3 + [np.radians(15.0)] * 3)
FASTEST = np.pi
"""Published for every joint of a UR5e, [rad / s]."""


def _displacement(xyz_mm: list[float], turn_deg: list[float]) -> np.ndarray:
    turn = Rotation.from_rotvec(turn_deg, degrees=True).as_matrix()
    return rigid_transform(turn, 1e-3 * np.array(xyz_mm))


NEAR = _displacement([12.0, -20.0, 15.0], [4.0, -6.0, 9.0])


def _camera_poses(n: int, scale: float) -> np.ndarray:
    """Poses over the whole range and in its corners."""
    rng = np.random.default_rng(1)
    u = np.concatenate([rng.uniform(-1, 1, (n, 6)), rng.choice([-1.0, 1.0], (n, 6))])
    return poses_from_displacements(T_WORLD_REF, scale * u * RANGES, 0.55)


def test_it_starts_with_its_camera_at_the_pose_asked_for() -> None:
    np.testing.assert_allclose(Arm(SCENE).true_pose, T_WORLD_REF, atol=1e-6)
    there = T_WORLD_REF @ NEAR
    np.testing.assert_allclose(Arm(SCENE, there).true_pose, there, atol=1e-6)


def test_a_move_arrives_and_tells_what_the_encoders_say() -> None:
    arm = Arm(SCENE)
    before = arm.pose
    executed = arm.move(NEAR)
    after = T_WORLD_BASE @ flange_pose(arm.joints)
    np.testing.assert_allclose(arm.pose, after, atol=1e-12)
    np.testing.assert_allclose(executed, inverse_transform(before) @ after, atol=1e-12)
    np.testing.assert_allclose(executed, NEAR, atol=2e-5)
    assert np.abs(executed - NEAR).max() > 1e-9  # servos are not perfect


def test_the_camera_is_where_the_physics_have_it() -> None:
    arm = Arm(SCENE)
    arm.move(NEAR)
    camera = arm._physics._data.body("camera")
    mujoco.mj_forward(arm._physics._model, arm._physics._data)
    np.testing.assert_allclose(arm.true_pose[:3, 3], camera.xpos, atol=1e-9)
    np.testing.assert_allclose(arm.true_pose[:3, :3], camera.xmat.reshape(3, 3), atol=1e-9)
    np.testing.assert_array_equal(arm.read(), FreeCamera(SCENE, arm.true_pose).read())


def test_servos_sag_by_millimetres_without_gravity_compensation() -> None:
    sag, angle = pose_error(Arm(SCENE, gravity_compensation=False).true_pose, T_WORLD_REF)
    assert 1e-3 < sag < 2e-2
    assert angle > 1e-4


def test_a_move_misses_by_less_than_a_fifth_of_a_millimetre_with_gravity_compensation() -> None:
    arm = Arm(SCENE)
    arm.move(NEAR)
    missed, _ = pose_error(arm.true_pose, T_WORLD_REF @ inverse_transform(MOUNT) @ NEAR @ MOUNT)
    assert missed < 2e-4


def test_sag_is_seen_by_the_encoders_and_told() -> None:
    arm = Arm(SCENE, gravity_compensation=False)
    wanted = arm.pose @ NEAR
    executed = arm.move(NEAR)
    missed, _ = pose_error(arm.pose, wanted)
    assert missed > 1e-3
    np.testing.assert_allclose(wanted @ inverse_transform(NEAR) @ executed, arm.pose, atol=1e-12)


def _watch(monkeypatch: pytest.MonkeyPatch) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Speeds of the joints and what the servos are told, at every step from now on."""
    speeds, commands, step = [], [], mujoco.mj_step

    def watched(model: object, data: object, *n: int) -> None:
        step(model, data, *n)
        speeds.append(data.qvel.copy())
        commands.append(data.ctrl.copy())

    monkeypatch.setattr(mujoco, "mj_step", watched)
    return speeds, commands


def test_sagged_servos_are_not_told_to_jump(monkeypatch: pytest.MonkeyPatch) -> None:
    arm = Arm(SCENE, gravity_compensation=False)
    before = arm._physics.commanded
    assert np.abs(before - arm.joints).max() > 1e-3
    _, commands = _watch(monkeypatch)
    arm.move(np.eye(4))
    assert np.abs(np.diff([before, *commands], axis=0)).max() < 2e-4


@pytest.mark.parametrize("gravity_compensation", [True, False])
def test_no_joint_ever_turns_faster_than_it_may(
    monkeypatch: pytest.MonkeyPatch, gravity_compensation: bool
) -> None:
    arm = Arm(SCENE, gravity_compensation=gravity_compensation)
    speeds, _ = _watch(monkeypatch)
    for pose in _camera_poses(4, 1.6):
        arm.move_to(pose @ inverse_transform(arm.mount))
    around = np.array([1.5, 0.0, 0.0, 0.0, 0.0, 0.0])
    for joints in (READY + around, READY, READY - around):
        arm.move_to(T_WORLD_BASE @ flange_pose(joints))
    assert FASTEST / 3 < np.abs(speeds).max() <= FASTEST


@pytest.mark.parametrize("scene", [SCENE, HEAD], ids=["plane", "head"])
@pytest.mark.parametrize("frame", ["camera", "flange"])
def test_the_whole_range_is_reached_far_from_limits(scene: Scene, frame: str) -> None:
    arm = Arm(scene)
    for pose in _camera_poses(20, 1.6):
        displacement = inverse_transform(T_WORLD_REF) @ pose
        arm.reset(T_WORLD_REF @ inverse_transform(arm.mount))
        flange = pose @ inverse_transform(arm.mount)
        arm.move_to(flange if frame == "camera" else arm.pose @ displacement)
        assert (np.abs(LIMITS - arm.joints) > np.radians(10)).all()
        arm.place_camera(pose)
        np.testing.assert_allclose(arm.true_pose, pose, atol=1e-6)


def _refused(arm: Arm, act: Callable[[], object], error: type[Exception], match: str) -> None:
    before = (arm.joints, arm.pose, arm.true_pose)
    with pytest.raises(error, match=match) as raised:
        act()
    assert "\n" not in str(raised.value)
    for was, now in zip(before, (arm.joints, arm.pose, arm.true_pose), strict=True):
        np.testing.assert_array_equal(was, now)


def test_what_is_out_of_reach_is_refused_standing_still() -> None:
    arm = Arm(SCENE)
    far = _displacement([0.0, 0.0, -1500.0], [0.0, 0.0, 0.0])
    _refused(arm, lambda: arm.move(far), RobotFaultError, "cannot reach the pose")


@pytest.mark.parametrize(
    ("scene", "into"), [(SCENE, "the table"), (HEAD, "the part")], ids=["table", "part"]
)
def test_the_table_and_the_part_are_not_driven_into(scene: Scene, into: str) -> None:
    arm = Arm(scene)
    pose = arm.pose
    pose[:3, 3] += [0.1, 0.15, -0.6]
    _refused(
        arm, lambda: arm.move_to(pose), RobotFaultError, f"into {into} after [0-9]+% of the way"
    )


def test_the_arm_does_not_hit_itself() -> None:
    arm = Arm(SCENE)
    fold = _displacement([100.0, 100.0, 100.0], [-60.0, 30.0, 20.0])
    _refused(arm, lambda: arm.move(fold), RobotFaultError, "bring the wrist 3 into the forearm")


@pytest.mark.parametrize(
    "bad",
    [np.full((4, 4), np.nan), 2 * np.eye(4), np.diag([1.0, 1.0, -1.0, 1.0]), np.eye(3)],
    ids=["nan", "scaled", "mirrored", "shape"],
)
def test_what_is_not_a_displacement_is_refused_standing_still(bad: np.ndarray) -> None:
    arm = Arm(SCENE)
    _refused(arm, lambda: arm.move(bad), InvalidInputError, "displacement must be a finite rigid")
    _refused(arm, lambda: arm.move_to(bad), InvalidInputError, "T_world_flange must be")
    _refused(arm, lambda: arm.reset(bad), InvalidInputError, "T_world_flange must be")


def test_a_move_that_does_not_settle_is_a_fault() -> None:
    arm = Arm(SCENE)
    arm.timeout = 0.05
    with pytest.raises(RobotFaultError, match=r"come to rest within 0.05 s: joint \d turns at"):
        arm.move(NEAR)
    np.testing.assert_allclose(arm.true_pose, arm.pose @ arm.mount, atol=1e-12)


def test_what_was_done_before_a_reset_leaves_no_trace() -> None:
    fresh, used = Arm(SCENE), Arm(SCENE)
    used.move(NEAR)
    used.move(inverse_transform(NEAR))
    assert not np.array_equal(used.true_pose, fresh.true_pose)
    for arm in (fresh, used):
        arm.reset()
        arm.rng = np.random.default_rng(5)
        arm.repeatability = Repeatability(1e-4, 1e-4)
        arm.move(NEAR)
    np.testing.assert_array_equal(used.true_pose, fresh.true_pose)
    np.testing.assert_array_equal(used.read(), fresh.read())


def test_a_reset_to_joint_angles_is_exact() -> None:
    arm = Arm(SCENE)
    joints = arm.joints + 0.01
    arm.reset(joints)
    np.testing.assert_allclose(arm.joints, joints, atol=1e-9)
    with pytest.raises(InvalidInputError, match="within the limits"):
        arm.reset(joints + 100)


def test_errors_of_motion_are_unseen_by_the_encoders() -> None:
    arm = Arm(SCENE, repeatability=Repeatability(1e-3), rng=np.random.default_rng(0))
    errors = []
    for _ in range(200):
        arm.move(np.eye(4))
        errors.append(np.linalg.norm((arm.true_pose - arm.pose @ arm.mount)[:3, 3]))
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(np.sqrt(3) * 1e-3, rel=0.1)


def test_links_lag_by_half_the_backlash_behind_the_side_they_come_from() -> None:
    play = 2e-3
    arm = Arm(SCENE, backlash=[play, 0, 0, 0, 0, 0])
    middle = arm.joints
    turn = 0.05 * np.eye(6)[0]
    lags = []
    for joints in (middle + turn, middle, middle - turn, middle):
        arm.move_to(T_WORLD_BASE @ flange_pose(joints))
        true_flange = T_WORLD_BASE @ flange_pose(arm.joints - np.eye(6)[0] * play / 2)
        lags.append(np.abs(arm.true_pose - true_flange @ arm.mount).max() < 1e-9)
    assert lags == [True, False, False, True]  # coming from below a link stays below


@pytest.mark.parametrize("backlash", [-1e-3, np.nan, [1e-3, 0.0], 1.0])
def test_impossible_backlash_is_refused(backlash: object) -> None:
    with pytest.raises(InvalidInputError, match="backlash must be one angle or 6"):
        Arm(SCENE, backlash=backlash)


@pytest.mark.parametrize("about_deg", [-120.0, 0.0, 75.0, 170.0])
def test_any_mount_on_the_flange_will_do(about_deg: float) -> None:
    turn = Rotation.from_euler("zxy", [about_deg, 10.0, -12.0], degrees=True).as_matrix()
    arm = Arm(SCENE, mount=rigid_transform(turn, [-0.04, 0.06, 0.05]))
    np.testing.assert_allclose(arm.true_pose, T_WORLD_REF, atol=1e-6)
    arm.move(NEAR)


def _first_pose(seed: int, used: bool) -> np.ndarray:
    arm = Arm(SCENE, repeatability=Repeatability(1e-3), rng=np.random.default_rng(seed))
    if used:
        arm.move(NEAR)
        arm.reset()
        arm.place_camera(T_WORLD_REF)
        arm.rng = np.random.default_rng(seed)
    arm.move(NEAR)
    return arm.true_pose


def test_another_process_makes_the_same_bit_for_bit() -> None:
    here = _first_pose(3, used=False)
    (there,) = in_processes(_first_pose, [(3, True)], 2)
    np.testing.assert_array_equal(here, there)
    assert not np.array_equal(here, _first_pose(4, used=False))


@pytest.mark.parametrize("timeout", [0.0, -1.0, np.nan, np.inf])
def test_impossible_timeouts_are_refused(timeout: float) -> None:
    with pytest.raises(InvalidInputError, match="timeout must be above 0"):
        Arm(SCENE, timeout=timeout)


def test_missing_mujoco_is_told_with_the_extra_that_brings_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ServoscopeError, match=r'pip install "servoscope\[arm\]"'):
        Arm(SCENE)
