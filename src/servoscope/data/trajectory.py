"""Poses in time, and the pose at any time between them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from servoscope.poses import rigid_transform


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses in time.

    Parameters
    ----------
    times : ndarray of shape (n,)
        In any order, [s].
    T_world_cam : ndarray of shape (n, 4, 4)
        [m].
    """

    times: NDArray[np.float64]
    T_world_cam: NDArray[np.float64]


def pair_in_time(
    trajectory: Trajectory,
    times: ArrayLike,
    pairing: Literal["interpolate", "nearest"] = "interpolate",
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The pose at each time, and how far the nearest pose of the trajectory is in time.

    Parameters
    ----------
    trajectory : Trajectory
        At least one pose.
    times : array of shape (n,)
        [s].
    pairing : {"interpolate", "nearest"}
        Between the poses before and after, at constant velocity and constant angular velocity
        (before the first pose and after the last, that pose); or the nearest pose as it stands.

    Returns
    -------
    T_world_cam : ndarray of shape (n, 4, 4)
        [m].
    gaps : ndarray of shape (n,)
        [s].

    Examples
    --------
    >>> poses = rigid_transform(np.eye(3), [[0.0, 0.0, 0.0], [0.4, 0.0, 0.0]])
    >>> T, gaps = pair_in_time(Trajectory(np.array([0.0, 1.0]), poses), [0.25, 0.875])
    >>> T[:, 0, 3], gaps
    (array([0.1 , 0.35]), array([0.25 , 0.125]))
    """
    order = np.argsort(trajectory.times, kind="stable")
    known, T_known = trajectory.times[order], trajectory.T_world_cam[order]
    times = np.asarray(times, dtype=float)
    after = np.searchsorted(known, times).clip(max=len(known) - 1)
    before = np.where(known[after] > times, (after - 1).clip(min=0), after)
    since, until = np.abs(times - known[before]), np.abs(known[after] - times)
    gaps = np.minimum(since, until)
    if pairing == "nearest":
        return T_known[np.where(since <= until, before, after)], gaps
    span = since + until
    share = np.divide(since, span, out=np.zeros_like(span), where=before != after)
    return _between(T_known[before], T_known[after], share), gaps


def _between(
    T_a: NDArray[np.float64], T_b: NDArray[np.float64], share: NDArray[np.float64]
) -> NDArray[np.float64]:
    R_a, R_b = (Rotation.from_matrix(T[:, :3, :3]) for T in (T_a, T_b))
    turn = (R_a.inv() * R_b).as_rotvec()
    R = R_a * Rotation.from_rotvec(share[:, None] * turn)
    t = (1 - share[:, None]) * T_a[:, :3, 3] + share[:, None] * T_b[:, :3, 3]
    return rigid_transform(R.as_matrix(), t)
