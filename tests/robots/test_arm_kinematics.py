"""Kinematics of the UR5e against the product of its published Denavit-Hartenberg transforms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from servoscope.errors import RobotFaultError
from servoscope.poses import is_rigid, pose_error
from servoscope.robots.arm_kinematics import (
    ACCELERATION,
    SPEED,
    TOLERANCE,
    flange_pose,
    inverse_kinematics,
    jacobian,
    link_frames,
    minimum_jerk,
)

PUBLISHED = """
    0       0.1625  1.570796327
   -0.425   0       0
   -0.3922  0       0
    0       0.1333  1.570796327
    0       0.0997 -1.570796327
    0       0.0996  0
"""
"""a [m], d [m] and alpha [rad] of each joint, Universal Robots, UR5e."""

POSTURE = np.array([0.3, -1.2, 1.7, -2.0, -1.4, 0.5])
WIDE = np.array([[-2 * np.pi] * 6, [2 * np.pi] * 6])
angles = arrays(float, 6, elements=st.floats(-np.pi, np.pi))
small = arrays(float, 6, elements=st.floats(-0.25, 0.25))


def _about(axis: int, angle: float) -> np.ndarray:
    T = np.eye(4)
    i, j = ((1, 2), (2, 0), (0, 1))[axis]
    T[[i, j], [i, j]] = np.cos(angle)
    T[i, j], T[j, i] = -np.sin(angle), np.sin(angle)
    return T


def _along(axis: int, distance: float) -> np.ndarray:
    T = np.eye(4)
    T[axis, 3] = distance
    return T


@given(angles)
def test_flange_is_at_the_product_of_the_published_transforms(joints: np.ndarray) -> None:
    T = np.eye(4)
    rows = np.array(PUBLISHED.split(), dtype=float).reshape(6, 3)
    for angle, (a, d, alpha) in zip(joints, rows, strict=True):
        T = T @ _about(2, angle) @ _along(2, d) @ _along(0, a) @ _about(0, alpha)
    np.testing.assert_allclose(flange_pose(joints), T, atol=1e-8)
    assert is_rigid(link_frames(joints))


@given(angles)
def test_jacobian_agrees_with_finite_differences(joints: np.ndarray) -> None:
    J = jacobian(link_frames(joints))
    h = 1e-6
    for i, step in enumerate(h * np.eye(6)):
        before, after = flange_pose(joints - step), flange_pose(joints + step)
        velocity = (after[:3, 3] - before[:3, 3]) / (2 * h)
        W = (after[:3, :3] - before[:3, :3]) / (2 * h) @ flange_pose(joints)[:3, :3].T
        np.testing.assert_allclose(J[:, i], [*velocity, W[2, 1], W[0, 2], W[1, 0]], atol=1e-7)


@given(small)
def test_joints_found_bring_the_flange_to_the_pose(turn: np.ndarray) -> None:
    there = flange_pose(POSTURE + turn)
    joints = inverse_kinematics(there, POSTURE, WIDE)
    distance, angle = pose_error(flange_pose(joints), there)
    assert distance < TOLERANCE
    assert angle < 1e-6


@given(small)
def test_joints_found_nearby_are_those_that_made_the_pose(turn: np.ndarray) -> None:
    joints = POSTURE + 0.4 * turn
    found = inverse_kinematics(flange_pose(joints), POSTURE, WIDE)
    np.testing.assert_allclose(found, joints, atol=1e-5)


def test_a_pose_too_far_away_is_refused_in_one_line() -> None:
    there = flange_pose(POSTURE)
    there[:3, 3] *= 3
    with pytest.raises(RobotFaultError, match=r"cannot reach the pose: it stays \d+\.\d mm") as e:
        inverse_kinematics(there, POSTURE, WIDE)
    assert "\n" not in str(e.value)


def test_limits_are_kept_and_named() -> None:
    limits = np.array([POSTURE - 0.1, POSTURE + 0.1])
    there = flange_pose(POSTURE + 0.09)
    joints = inverse_kinematics(there, POSTURE, limits)
    assert (limits[0] <= joints).all()
    assert (joints <= limits[1]).all()
    with pytest.raises(RobotFaultError, match=r"joint [\d, ]+ at its limit"):
        inverse_kinematics(flange_pose(POSTURE + 0.2), POSTURE, limits)


STEP = 1e-3


@given(st.floats(1e-3, 6.0), st.floats(-1.0, 1.0))
def test_speed_and_acceleration_are_kept(far: float, less: float) -> None:
    start, goal = np.array([0.5, -0.2]), np.array([0.5 + far, -0.2 + less * far])
    course = np.concatenate([[start] * 2, minimum_jerk(start, goal, STEP), [goal] * 2])
    speed = np.diff(course, axis=0) / STEP
    assert np.abs(speed).max() <= SPEED * (1 + 1e-9)
    assert np.abs(np.diff(speed, axis=0)).max() / STEP <= ACCELERATION * (1 + 1e-6)


@pytest.mark.parametrize(("far", "what"), [(0.2, "acceleration"), (3.0, "speed")])
def test_no_time_is_wasted(far: float, what: str) -> None:
    course = np.concatenate([np.zeros((2, 1)), minimum_jerk(np.zeros(1), np.full(1, far), STEP)])
    speed = np.diff(course[:, 0]) / STEP
    fastest = {"speed": speed.max() / SPEED, "acceleration": np.diff(speed).max() / STEP}
    fastest["acceleration"] /= ACCELERATION
    assert fastest[what] > 0.98


def test_it_ends_at_the_goal_exactly_and_stays_when_there_is_nothing_to_do() -> None:
    goal = np.array([0.1, 0.7, -0.3])
    np.testing.assert_array_equal(minimum_jerk(np.zeros(3), goal, STEP)[-1], goal)
    np.testing.assert_array_equal(minimum_jerk(goal, goal, STEP), [goal])
