"""When the camera has arrived."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from servoscope.poses import displacements_from_poses, pose_error, poses_from_displacements
from servoscope.positioning.interfaces import Array, Estimate
from servoscope.positioning.settings import LoopSettings


def is_within_tolerance(displacement: Array, settings: LoopSettings) -> bool:
    """Whether a displacement (4, 4) is under the tolerances of distance and angle."""
    distance, angle = pose_error(np.eye(4), displacement)
    tolerance_m, tolerance_rad = settings.tolerance_mm / 1e3, np.radians(settings.tolerance_deg)
    return bool(distance <= tolerance_m and angle <= tolerance_rad)


def is_noise_only(estimates: Sequence[Estimate], pivot: float, settings: LoopSettings) -> bool:
    """Whether the last two estimates, of one stage, tell nothing but noise.

    One is not enough: a coarse stage that sees nothing more may hand over to a finer one, and the
    move that it asks for brings the camera nearer still.
    """
    last = estimates[-2:]
    return (
        len(last) == 2
        and last[0].stage == last[1].stage
        and last[1].is_finest
        and all(_is_noise(estimate, pivot, settings) for estimate in last)
        and last[1].distance >= 0.5 * last[0].distance
    )


def _is_noise(estimate: Estimate, pivot: float, settings: LoopSettings) -> bool:
    """Whether what is believed is no more than noise.

    An estimate scatters by its own deviation about an error that is as large, left by the
    estimate before: by 1.4 deviations, where only noise is left.
    """
    delta_p = displacements_from_poses(np.eye(4), estimate.displacement[None], pivot)[0]
    std = np.hypot(estimate.std, _repeatability(pivot, settings))
    known = np.isfinite(std) & (std > 0)
    if not known.any():
        return False
    if np.sqrt(np.mean((delta_p[known] / std[known]) ** 2)) > settings.noise_limit:
        return False
    significant = np.where(known, 0.0, delta_p)
    return is_within_tolerance(
        poses_from_displacements(np.eye(4), significant[None], pivot)[0], settings
    )


def _repeatability(pivot: float, settings: LoopSettings) -> Array:
    """What the robot's own scatter makes of each dof about the pivot, (6,), [m] and [rad]."""
    position, rotation = settings.repeatability_mm / 1e3, np.radians(settings.repeatability_deg)
    sideways = np.hypot(position, pivot * rotation)
    return np.array([sideways, sideways, position, rotation, rotation, rotation])
