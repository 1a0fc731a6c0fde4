"""The model that MuJoCo compiles, against the published frames, masses and centres of mass."""

import numpy as np
import pytest

from servoscope.poses import rigid_transform
from servoscope.robots.arm_kinematics import link_frames
from servoscope.robots.arm_model import CAMERA_MASS, LINKS, arm_mjcf

mujoco = pytest.importorskip("mujoco", reason="the arm needs MuJoCo, the extra `arm`")

T_WORLD_BASE = rigid_transform(
    [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], [0.3, -0.2, 2.0]
)
T_FLANGE_CAM = rigid_transform(
    [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], [0.1, 0.0, 0.2]
)
BOUNDS = [[-0.2, -0.1, -0.3], [0.2, 0.1, -0.1]]
PUBLISHED = {
    "shoulder": (3.761, [0, -0.02561, 0.00193]),
    "upper arm": (8.058, [0.2125, 0, 0.11336]),
    "forearm": (2.846, [0.15, 0.0, 0.0265]),
    "wrist 1": (1.37, [0, -0.0018, 0.01634]),
    "wrist 2": (1.3, [0, 0.0018, 0.01634]),
    "wrist 3": (0.365, [0, 0, -0.001159]),
}
"""Masses, [kg], and centres of mass, [m], Universal Robots, UR5e."""

POSTURES = np.random.default_rng(0).uniform(-np.pi, np.pi, (5, 6))


def _model(gravity_compensation: bool) -> object:
    text = arm_mjcf(T_WORLD_BASE, T_FLANGE_CAM, BOUNDS, gravity_compensation)
    return mujoco.MjModel.from_xml_string(text)


def _potential_energy(joints: np.ndarray) -> float:
    frames = T_WORLD_BASE @ link_frames(joints)
    heights = [
        mass * (frame @ [*centre, 1.0])[2]
        for (mass, centre), frame in zip(PUBLISHED.values(), frames[1:], strict=True)
    ]
    camera = CAMERA_MASS * (frames[-1] @ T_FLANGE_CAM)[2, 3]
    return float(9.81 * (sum(heights) + camera))


@pytest.mark.parametrize("joints", POSTURES)
def test_links_lie_in_their_published_frames(joints: np.ndarray) -> None:
    model = _model(True)
    data = mujoco.MjData(model)
    data.qpos[:] = joints
    mujoco.mj_kinematics(model, data)
    frames = T_WORLD_BASE @ link_frames(joints)
    frames = np.concatenate([frames, [frames[-1] @ T_FLANGE_CAM]])
    names = ["base", *PUBLISHED, "camera"]
    for name, frame in zip(names, frames, strict=True):
        np.testing.assert_allclose(data.body(name).xpos, frame[:3, 3], atol=1e-12)
        np.testing.assert_allclose(data.body(name).xmat.reshape(3, 3), frame[:3, :3], atol=1e-12)


@pytest.mark.parametrize("joints", POSTURES)
def test_gravity_pulls_at_joints_as_the_published_masses_do(joints: np.ndarray) -> None:
    model = _model(False)
    data = mujoco.MjData(model)
    data.qpos[:] = joints
    mujoco.mj_forward(model, data)
    h = 1e-6
    torques = [
        (_potential_energy(joints + step) - _potential_energy(joints - step)) / (2 * h)
        for step in h * np.eye(6)
    ]
    np.testing.assert_allclose(data.qfrc_bias, torques, atol=1e-6)


def test_compensation_takes_all_of_gravity_away() -> None:
    model = _model(True)
    data = mujoco.MjData(model)
    data.qpos[:] = POSTURES[0]
    mujoco.mj_forward(model, data)
    assert np.abs(data.qfrc_bias).max() > 1
    np.testing.assert_allclose(data.qfrc_passive, data.qfrc_bias, atol=1e-9)


def test_links_side_by_side_may_touch_and_others_may_not() -> None:
    """Stretched out nothing touches, folded double the wrist is in the shoulder."""
    model = _model(True)
    data = mujoco.MjData(model)
    for joints, touches in (([0.0] * 6, False), ([0.0, 0.0, np.pi, 0.0, 0.0, 0.0], True)):
        data.qpos[:] = joints
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        assert (data.ncon > 0) == touches


def test_servos_have_the_published_torques() -> None:
    assert [link.servo.torque for link in LINKS] == [150, 150, 150, 28, 28, 28]
    np.testing.assert_array_equal(_model(True).actuator_forcerange[:, 1], [150] * 3 + [28] * 3)
