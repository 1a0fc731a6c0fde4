"""What is known beforehand of the camera and of the poses that a keyframe is fitted to."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from servoscope.keyframe import CameraModel

TRACKER = 2e-3, 3e-3
"""Deviations of the poses of a sequence, [m] and [rad], unless others are given."""


@dataclass(frozen=True)
class Calibration:
    """What need not be found from images.

    Parameters
    ----------
    camera : CameraModel, optional
        Its lens, which is then held.
    pose_noise : tuple of 2 floats, optional
        Standard deviations of the reported poses, [m] and [rad]; by default those of a robot, or,
        where the images are a sequence, of a tracker.
    distance : float, optional
        Of the part from the camera, within a factor of two or so, [m].
    """

    camera: CameraModel | None = None
    pose_noise: tuple[float, float] | None = None
    distance: float | None = None

    def options(self, *, is_sequence: bool) -> dict[str, Any]:
        """Options of `Keyframe.fit`."""
        given: dict[str, Any] = {name: x for name, x in vars(self).items() if x is not None}
        return ({"pose_noise": TRACKER} if is_sequence else {}) | given
