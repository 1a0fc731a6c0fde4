"""Poses in time as text that other programs read: TUM's and KITTI's."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from servoscope.data.images import PoseImageSet
from servoscope.errors import InvalidInputError
from servoscope.poses import quaternions_xyzw
from servoscope.positioning.run_log import read_steps
from servoscope.storage.folders import write_text

Array = NDArray[np.float64]

FORMATS = ("tum", "kitti")
"""A stamp, a position and a quaternion in a row; or the upper three rows of the matrix."""


class TimedPoses(NamedTuple):
    """Poses ``T_world_cam``, (n, 4, 4), [m], and when they were, (n,), [s].

    Where that is not known the stamps are 0, 1, 2 and so on, and `is_timed` is false.
    """

    T_world_cam: Array
    times: Array
    is_timed: bool


def poses_of_data(data: PoseImageSet) -> TimedPoses:
    """The poses of a data set, in the order of its images."""
    if data.times is None:
        return TimedPoses(data.T_world_cam, np.arange(len(data), dtype=float), False)
    return TimedPoses(data.T_world_cam, data.times, True)


def poses_of_log(folder: Path) -> TimedPoses:
    """The poses at which the robot looked in a run, as it believed them.

    Raises
    ------
    RunFolderError
        If the log is missing or damaged.
    InvalidInputError
        If there is no look in it.
    """
    poses = [step.pose for step, _ in read_steps(folder)]
    if not poses:
        raise InvalidInputError(f"The log {folder} holds no look; name that of another run.")
    return TimedPoses(np.stack(poses), np.arange(len(poses), dtype=float), False)


def as_text(poses: TimedPoses, form: str) -> str:
    """A trajectory as text.

    Parameters
    ----------
    poses : TimedPoses
    form : {"tum", "kitti"}

    Examples
    --------
    >>> aside = np.eye(4)[None].copy()
    >>> aside[0, 0, 3] = 0.1
    >>> print(as_text(TimedPoses(aside, np.zeros(1), True), "tum"), end="")
    # timestamp tx ty tz qx qy qz qw
    0.000000 0.100000000 0.000000000 0.000000000 0 0 0 1
    >>> print(as_text(TimedPoses(aside, np.zeros(1), True), "kitti"), end="")
    1 0 0 0.1 0 1 0 0 0 0 1 0
    """
    T, times, _ = poses
    if form == "kitti":
        return "".join(" ".join(f"{x:.12g}" for x in row) + "\n" for row in _upper(T))
    if form != "tum":
        raise InvalidInputError(f"A trajectory is of {' or '.join(FORMATS)}, got {form!r}.")
    lines = ["# timestamp tx ty tz qx qy qz qw"]
    for time, t, q in zip(times, T[:, :3, 3], quaternions_xyzw(T), strict=True):
        position = " ".join(f"{x + 0.0:.9f}" for x in t)
        lines.append(f"{time:.6f} {position} " + " ".join(f"{x + 0.0:.12g}" for x in q))
    return "\n".join(lines) + "\n"


def write_trajectory(path: Path, poses: TimedPoses, form: str) -> None:
    """Write `as_text`, whole or not at all."""
    write_text(path, as_text(poses, form))


def _upper(T: Array) -> Array:
    """The upper three rows of each matrix, one after the other, (n, 12)."""
    return T[:, :3].reshape(len(T), 12) + 0.0
