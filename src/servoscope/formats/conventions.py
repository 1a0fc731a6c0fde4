"""From the pose conventions of a file to ``T_world_cam`` with OpenCV axes in metres."""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.errors import ServoscopeWarning
from servoscope.formats.options import Axes, Direction, QuaternionOrder, Units
from servoscope.poses import inverse_transform, poses_from_quaternions

METRES = {"m": 1.0, "mm": 1e-3}
"""Metres of each unit."""

_OPENCV_FROM = {"opencv": np.eye(4), "opengl": np.diag([1.0, -1.0, -1.0, 1.0])}
_LENGTH_TOLERANCE = 0.01


def T_world_cam_from_numbers(
    numbers: ArrayLike,
    *,
    direction: Direction = "camera-to-world",
    units: Units = "m",
    quaternion_order: QuaternionOrder = "xyzw",
    axes: Axes = "opencv",
) -> NDArray[np.float64]:
    """Camera poses in servoscope's convention from translations and quaternions in any other.

    Parameters
    ----------
    numbers : array of shape (n, 7)
        Translation, then quaternion.
    direction : {"camera-to-world", "world-to-camera"}
        What the given transforms map.
    units : {"m", "mm"}
        Of the translations.
    quaternion_order : {"xyzw", "wxyz"}
        Scalar last or scalar first.
    axes : {"opencv", "opengl"}
        Camera axes of the given transforms: x right, y down, z forward; or x right, y up,
        z backward.

    Returns
    -------
    T_world_cam : ndarray of shape (n, 4, 4)
        Camera to world, [m], with OpenCV axes.

    Raises
    ------
    InvalidInputError
        If a number is not finite or a quaternion has zero length.

    Warns
    -----
    ServoscopeWarning
        If quaternions are so far from unit length that something else may stand there.

    Examples
    --------
    A world origin that the camera sees 550 mm ahead:

    >>> T = T_world_cam_from_numbers(
    ...     [[0, 0, 550, 0, 0, 0, 1]], direction="world-to-camera", units="mm"
    ... )
    >>> float(T[0, 2, 3])
    -0.55
    """
    numbers = np.asarray(numbers, dtype=float).reshape(-1, 7)
    quaternion = numbers[:, 3:]
    if quaternion_order == "wxyz":
        quaternion = np.roll(quaternion, -1, axis=1)
    _check_unit_length(quaternion)
    T = poses_from_quaternions(numbers[:, :3] * METRES[units], quaternion)
    if direction == "world-to-camera":
        T = inverse_transform(T)
    return T @ _OPENCV_FROM[axes]


def _check_unit_length(quaternion: NDArray[np.float64]) -> None:
    lengths = np.linalg.norm(quaternion, axis=1)
    odd = np.abs(lengths - 1) > _LENGTH_TOLERANCE
    if odd.any():
        warnings.warn(
            f"{odd.sum()} of {len(odd)} quaternions are not of unit length "
            f"({lengths.min():.3g} to {lengths.max():.3g}); they were normalised, but check that "
            "the columns are quaternions.",
            ServoscopeWarning,
            stacklevel=3,
        )
