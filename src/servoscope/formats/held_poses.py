"""Poses that a tracker held while the camera moved on: the last one it knew, or the identity."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
from numpy.typing import NDArray

from servoscope.formats.frames import Frames

_LEAST_CHANGE = 0.5
_ROUNDED = 1e-9


def held_poses(images: NDArray[np.uint8], frames: Frames) -> NDArray[np.bool_]:
    """Which frames share their pose with others, though their images differ as those of others do.

    Several images taken from one pose differ by noise alone. Those whose first and later ones
    differ, in the median, by half as much as neighbours of different poses do were not taken there.

    Parameters
    ----------
    images : ndarray of shape (n, height, width), uint8
    frames : Frames
        Of n images.

    Returns
    -------
    ndarray of shape (n,), bool
    """
    held = np.zeros(len(frames), dtype=bool)
    numbers = np.round(frames.T_world_cam[:, :3].reshape(-1, 12) / _ROUNDED).astype(np.int64) + 0
    by_pose: dict[bytes, list[int]] = defaultdict(list)
    for i, row in enumerate(numbers):
        by_pose[row.tobytes()].append(i)
    shared = [members for members in by_pose.values() if len(members) > 1]
    moved = np.flatnonzero((numbers[1:] != numbers[:-1]).any(axis=1))
    if not shared or not moved.size:
        return held
    some = moved[:: 1 + len(moved) // 200]
    usual = np.median([_difference(images[i], images[i + 1]) for i in some])
    for first, *others in shared:
        changes = [_difference(images[first], images[i]) for i in others]
        held[[first, *others]] = np.median(changes) > max(_LEAST_CHANGE * usual, 1.0)
    return held


def _difference(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> float:
    """Mean difference of the grey levels."""
    return float(np.abs(a.astype(np.int16) - b).mean())
