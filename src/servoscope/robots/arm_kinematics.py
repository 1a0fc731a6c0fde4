"""Forward and inverse kinematics of a UR5e."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from servoscope.errors import RobotFaultError

Array = NDArray[np.float64]

A = np.array([0.0, -0.425, -0.3922, 0.0, 0.0, 0.0])
"""Lengths of the links along their x, [m]."""

D = np.array([0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996])
"""Offsets of the links along the axes of their joints, [m]."""

ALPHA = np.array([np.pi / 2, 0.0, 0.0, np.pi / 2, -np.pi / 2, 0.0])
"""Twists of the links, [rad]."""

TOLERANCE = 1e-7
"""What is left of an error when inverse kinematics is content, [m] and [rad]."""

_MAX_ITERATIONS = 60
_LARGEST_STEP = 0.3
_COS_ALPHA, _SIN_ALPHA = np.cos(ALPHA).round(15), np.sin(ALPHA).round(15)


def link_frames(joints: ArrayLike) -> Array:
    """Frames (7, 4, 4) of the base and of the six links, the last of which is the flange, [m].

    Notes
    -----
    Each link is turned and shifted from the one before by ``Rz(q) Tz(d) Tx(a) Rx(alpha)``. The
    parameters are those that Universal Robots publishes for the UR5e, "DH Parameters for
    calculations of kinematics and dynamics", universal-robots.com.

    Examples
    --------
    >>> link_frames(np.zeros(6))[-1].round(4) + 0.0
    array([[ 1.    ,  0.    ,  0.    , -0.8172],
           [ 0.    ,  0.    , -1.    , -0.2329],
           [ 0.    ,  1.    ,  0.    ,  0.0628],
           [ 0.    ,  0.    ,  0.    ,  1.    ]])
    """
    cos, sin = np.cos(joints), np.sin(joints)
    steps = np.zeros((6, 4, 4))
    steps[:, 0, 0], steps[:, 1, 0] = cos, sin
    steps[:, 0, 1], steps[:, 1, 1] = -sin * _COS_ALPHA, cos * _COS_ALPHA
    steps[:, 0, 2], steps[:, 1, 2] = sin * _SIN_ALPHA, -cos * _SIN_ALPHA
    steps[:, 2, 1], steps[:, 2, 2] = _SIN_ALPHA, _COS_ALPHA
    steps[:, 0, 3], steps[:, 1, 3], steps[:, 2, 3] = A * cos, A * sin, D
    steps[:, 3, 3] = 1.0
    frames = np.empty((7, 4, 4))
    frames[0] = np.eye(4)
    for i in range(6):
        frames[i + 1] = frames[i] @ steps[i]
    return frames


def flange_pose(joints: ArrayLike) -> Array:
    """``T_base_flange`` of shape (4, 4), [m], at joint angles of shape (6,), [rad]."""
    return link_frames(joints)[-1]


def jacobian(frames: Array) -> Array:
    """How fast the flange moves and turns with each joint, in the axes of the base, (6, 6).

    Rows are velocities, [m / rad], and angular velocities; columns are joints.
    """
    axes, origins = frames[:-1, :3, 2], frames[:-1, :3, 3]
    return np.concatenate([np.cross(axes, frames[-1, :3, 3] - origins), axes], axis=1).T


def inverse_kinematics(T_base_flange: ArrayLike, start: ArrayLike, limits: ArrayLike) -> Array:
    """Joint angles near `start`, [rad], at which the flange is within `TOLERANCE` of a pose.

    A pose that is not reached within the smallest and largest angles, `limits` (2, 6), is a fault.

    Notes
    -----
    Damped least squares, ``dq = J^T (J J^T + w I)^-1 e`` with the error e = (translation, rotation
    vector). The damping w is a share of the squared error, so that steps are careful far away and
    Newton's at the end: T. Sugihara, "Solvability-unconcerned inverse kinematics by the
    Levenberg-Marquardt method", IEEE Trans. Robotics 27(5), 2011. Steps are cut off at the limits.

    Examples
    --------
    >>> there = flange_pose([0.1, -1.4, 1.6, -1.8, -1.5, 0.2])
    >>> q = inverse_kinematics(there, [0.0, -1.5, 1.5, -1.6, -1.6, 0.0], [[-3.0] * 6, [3.0] * 6])
    >>> q.round(6).tolist()
    [0.1, -1.4, 1.6, -1.8, -1.5, 0.2]
    """
    target, (low, high) = np.asarray(T_base_flange, dtype=float), np.asarray(limits, dtype=float)
    joints = np.clip(np.asarray(start, dtype=float), low, high)
    for _ in range(_MAX_ITERATIONS):
        frames = link_frames(joints)
        error = _error(frames[-1], target)
        if np.linalg.norm(error[:3]) < TOLERANCE and np.linalg.norm(error[3:]) < TOLERANCE:
            return joints
        J = jacobian(frames)
        damping = 0.1 * (error @ error) + 1e-12
        step = J.T @ np.linalg.solve(J @ J.T + damping * np.eye(6), error)
        step *= min(1.0, _LARGEST_STEP / np.abs(step).max())
        joints = np.clip(joints + step, low, high)
    raise RobotFaultError(_why_not(joints, error, low, high))


def _error(T: Array, target: Array) -> Array:
    """What is missing from one pose to another, in the axes of the base, shape (6,)."""
    turn = Rotation.from_matrix(target[:3, :3] @ T[:3, :3].T).as_rotvec()
    return np.concatenate([target[:3, 3] - T[:3, 3], turn])


def _why_not(joints: Array, error: Array, low: Array, high: Array) -> str:
    at_limit = 1 + np.flatnonzero((joints <= low) | (joints >= high))
    where = f"joint {', '.join(map(str, at_limit))} at its limit" if at_limit.size else "too far"
    return (
        f"The arm cannot reach the pose: it stays {1e3 * np.linalg.norm(error[:3]):.1f} mm and "
        f"{np.degrees(np.linalg.norm(error[3:])):.1f} deg away ({where}); "
        "ask for one that is nearer."
    )


SPEED = np.radians(90.0)
"""Joints turn no faster than this: half of what a UR5e can, [rad / s]."""

ACCELERATION = np.radians(180.0)
"""[rad / s^2]"""

_PEAK_SPEED, _PEAK_ACCELERATION = 15 / 8, 10 / np.sqrt(3)
"""Of the minimum-jerk course over unit distance in unit time."""


def minimum_jerk(start: Array, goal: Array, timestep: float) -> Array:
    """Joint angles (n_steps, n_joints) on the straight way between two postures; the last is
    `goal`. All joints start and arrive together, and the one that turns farthest keeps just below
    `SPEED` and `ACCELERATION`.

    Notes
    -----
    ``q(s) = start + (10 s^3 - 15 s^4 + 6 s^5) (goal - start)``: T. Flash and N. Hogan, "The
    coordination of arm movements", J. Neuroscience 5(7), 1985.

    Examples
    --------
    >>> course = minimum_jerk(np.zeros(1), np.ones(1), timestep=0.2)
    >>> course[:, 0].round(3).tolist()
    [0.023, 0.145, 0.368, 0.632, 0.855, 0.977, 1.0]
    """
    farthest = np.abs(goal - start).max()
    duration = max(
        _PEAK_SPEED * farthest / SPEED, np.sqrt(_PEAK_ACCELERATION * farthest / ACCELERATION)
    )
    n_steps = max(1, int(np.ceil(duration / timestep)))
    s = np.arange(1, n_steps + 1)[:, None] / n_steps
    course: Array = start + (s**3 * (10 - 15 * s + 6 * s**2)) * (goal - start)
    course[-1] = goal
    return course
