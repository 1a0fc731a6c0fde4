"""When the camera has arrived, and when it can come no nearer."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from servoscope.poses import (
    DISPLAY_FACTORS,
    DISPLAY_UNITS,
    DOFS,
    displacements_from_poses,
    pose_error,
    poses_from_displacements,
)
from servoscope.positioning.interfaces import Array, Estimate
from servoscope.positioning.reference_view import Comparison
from servoscope.positioning.result import Step
from servoscope.positioning.settings import LEAST_BOX, NEAR_ENOUGH, LoopSettings

_EQUAL_CELLS, _EQUAL_SHIFT, _EQUAL_SIGNIFICANCE = 0.9, 2e-3, 2.0
STEADY_SHIFT = _EQUAL_SHIFT / 4
"""An image that is displaced by no more, as a share of its width, may be of the same view."""

_EQUAL_DIFFERENCE, _EQUAL_STRUCTURE = 0.2, 1.5
_OTHERWISE, _OTHER_LIGHT = 2.5, 4.0
_FLOOR_LOOKS = 4
_SIGNIFICANT = 1.5
_FLOOR_SHRINKAGE = 0.7
_PART = 0.1


class Reached(NamedTuple):
    """Distance, angle and dofs in the units of the tolerances.

    Parameters
    ----------
    mm, deg : float
        Of the frame that the robot reports.
    dofs : ndarray of shape (6,)
        About the pivot, [mm] and [deg].
    """

    mm: float
    deg: float
    dofs: Array

    @classmethod
    def of_displacement(cls, displacement: Array, pivot: float) -> Reached:
        """Of a displacement (4, 4), [m]."""
        distance, angle = pose_error(np.eye(4), displacement)
        delta_p = displacements_from_poses(np.eye(4), displacement[None], pivot)[0]
        return cls(1e3 * float(distance), float(np.degrees(angle)), np.abs(delta_p) * _SHOWN)

    @classmethod
    def of_deviation(cls, std: Array, pivot: float) -> Reached:
        """Of deviations about the pivot, (6,), [m] and [rad]; NaN where one is not known."""
        position, rotation = std[:3], std[3:]
        swing = pivot * np.array([rotation[1], rotation[0], 0.0])
        mm = 1e3 * float(np.sqrt(np.sum(position**2 + swing**2)))
        return cls(mm, float(np.degrees(np.sqrt(np.sum(rotation**2)))), std * _SHOWN)

    def excess(self, settings: LoopSettings) -> str | None:
        """What is above the tolerances that were asked for; None if nothing is."""
        above = [
            f"{got:.3g} {unit} of {what}, {wanted:g} {unit} asked for"
            for got, wanted, what, unit in self._pairs(settings)
            if not got <= wanted
        ]
        return above[0] if above else None

    def _pairs(self, settings: LoopSettings) -> list[tuple[float, float, str, str]]:
        pairs = []
        if settings.tolerance_mm is not None:
            pairs.append((self.mm, settings.tolerance_mm, "distance", "mm"))
        if settings.tolerance_deg is not None:
            pairs.append((self.deg, settings.tolerance_deg, "angle", "deg"))
        for dof, wanted in settings.tolerances.items():
            i = DOFS.index(dof)
            pairs.append((float(self.dofs[i]), wanted, dof, DISPLAY_UNITS[i]))
        return pairs


_SHOWN = np.array(DISPLAY_FACTORS, dtype=float)


def is_within_tolerance(displacement: Array, settings: LoopSettings, pivot: float = 0.0) -> bool:
    """Whether a displacement (4, 4) is under the tolerances, or near enough where none is set."""
    reached = Reached.of_displacement(displacement, pivot)
    mm = NEAR_ENOUGH["mm"] if settings.tolerance_mm is None else settings.tolerance_mm
    deg = NEAR_ENOUGH["deg"] if settings.tolerance_deg is None else settings.tolerance_deg
    return reached.mm <= mm and reached.deg <= deg and reached.excess(settings) is None


def is_noise_only(estimates: Sequence[Estimate], pivot: float, settings: LoopSettings) -> bool:
    """Whether the last two estimates, of one stage, hold nothing but noise.

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


def is_averaged(estimate: Estimate, pivot: float, settings: LoopSettings) -> bool:
    """Whether more images from the same pose can say more than one."""
    return (
        estimate.is_finest
        and not settings.is_coarse
        and settings.final_images > 2
        and bool(np.isfinite(estimate.std).any())
        and (is_at_hand(estimate.displacement, settings) or _is_noise(estimate, pivot, settings))
    )


def asks_for_a_move(
    first: Estimate,
    mean: Estimate,
    n_images: int,
    pivot: float,
    settings: LoopSettings,
    scatter: Array | None,
) -> bool:
    """Whether the mean of several images shows more than its noise and the robot's scatter.

    By how much the first image differs from the mean says how noisy one is: what is believed of
    an estimate holds errors that all images share, too. A mean that is within a tolerance that was
    asked for asks for no move.

    Parameters
    ----------
    first, mean : Estimate
        Of the first image, and of the mean of all.
    n_images : int
        Two or more.
    pivot : float
        [m].
    settings : LoopSettings
    scatter : ndarray of shape (6,) or None
        Of the robot, as far as it was seen, about the pivot, [m] and [rad].
    """
    if settings.has_tolerance and is_within_tolerance(mean.displacement, settings, pivot):
        return False
    noise = _noise_of_mean(first.displacement, mean, n_images, pivot)
    known = np.isfinite(noise)
    if not known.any():
        return False
    robot = settings.repeatability(pivot) if scatter is None else scatter
    variance = noise[known] + robot[known] ** 2
    if not (variance > 0).all():
        return False
    delta_p = displacements_from_poses(np.eye(4), mean.displacement[None], pivot)[0]
    return bool(np.mean(delta_p[known] ** 2 / variance) > _SIGNIFICANT**2)


def _noise_of_mean(first: Array, mean: Estimate, n_images: int, pivot: float) -> Array:
    """Variance of the mean of several images, (6,), by how much that of the first differs from it.

    In shares of what is believed of each dof; NaN where nothing is.
    """
    both = np.stack([first, mean.displacement])
    delta_p = displacements_from_poses(np.eye(4), both, pivot)
    known = np.isfinite(mean.std) & (mean.std > 0)
    if not known.any():
        return np.full(6, np.nan)
    ratio = np.mean(((delta_p[0] - delta_p[1])[known] / mean.std[known]) ** 2) / (n_images - 1)
    return np.where(known, ratio * np.square(mean.std), np.nan)


def is_equal(comparison: Comparison) -> bool:
    """Whether an image equals the reference to within noise.

    Nearly all of the view shows what the reference shows, in the same grey levels, displaced by no
    more than noise makes of no displacement at all, and what is left looks like noise.
    """
    return (
        comparison.structure <= _EQUAL_STRUCTURE
        and comparison.difference <= _EQUAL_DIFFERENCE
        and comparison.matched >= _EQUAL_CELLS
        and comparison.shift <= _EQUAL_SHIFT
        and comparison.significance <= _EQUAL_SIGNIFICANCE
    )


def doubts(step: Step, settings: LoopSettings) -> list[str]:
    """Why the camera may not have arrived though it seems so; empty if nothing speaks against it.

    Returns
    -------
    list of str
        What was found and what was needed.
    """
    found = []
    seen = step.comparison
    if not step.estimate.is_finest:
        found.append(f"{step.estimate.stage} answered, which is not the finest stage")
    if seen is not None and seen.matched < settings.least_matched:
        found.append(
            f"{seen.matched:.0%} of the view match the reference, and at least "
            f"{settings.least_matched:.0%} must: free the view and check the part"
        )
    elif seen is not None and seen.shift > settings.largest_shift:
        found.append(
            f"the view is still displaced by {seen.shift:.2%} of its width, and at most "
            f"{settings.largest_shift:.2%} are allowed"
        )
    return found


def is_otherwise(step: Step) -> bool:
    """Whether the view differs so much from the reference that no accuracy can be believed.

    And not since it is displaced: no displacement explains the difference.
    """
    seen = step.comparison
    return (
        seen is not None
        and seen.structure > _OTHER_LIGHT
        and seen.significance < 2 * _EQUAL_SIGNIFICANCE
    )


def caution(step: Step) -> str:
    """What the believed deviation does not include, as an end of a message."""
    if step.comparison is None or step.comparison.structure <= _OTHERWISE:
        return ""
    return (
        " What differs from the reference is not noise but a light, a part or a cover, and the "
        "believed deviation does not include what that does."
    )


def supports(estimate: Estimate, settings: LoopSettings, pivot: float) -> str | None:
    """What of the believed deviation is above the tolerances asked for, None if nothing is.

    An estimator that believes no deviation says nothing against them; the image has to match.
    """
    if np.isnan(estimate.std).all():
        return None
    std = np.where(np.isnan(estimate.std), 0.0, estimate.std)
    return Reached.of_deviation(std, pivot).excess(settings)


def is_at_hand(displacement: Array, settings: LoopSettings) -> bool:
    """Whether a displacement is no more than a robot may miss a move by."""
    distance, angle = pose_error(np.eye(4), displacement)
    limits = settings.execution_mm / 1e3, np.radians(settings.execution_deg)
    return bool(distance <= limits[0] and angle <= limits[1])


def is_displaced(comparison: Comparison | None) -> bool:
    """Whether an image is displaced from another for certain, by a noticeable part of a pixel."""
    if comparison is None:
        return False
    return comparison.shift > STEADY_SHIFT and comparison.significance > 2 * _EQUAL_SIGNIFICANCE


def unread(estimate: Estimate, reach: Array) -> list[str]:
    """Dofs that are no better known than anywhere within the reach, and 5 mm or 1 degree."""
    guess = np.maximum(reach / np.sqrt(3), LEAST_BOX)
    return [dof for dof, std, most in zip(DOFS, estimate.std, guess, strict=True) if std >= most]


def is_back(steps: Sequence[Step]) -> bool:
    """Whether the last move ended at a pose where an earlier look was taken."""
    if len(steps) < 2 or steps[-2].executed is None:
        return False
    return any(np.allclose(step.pose, steps[-1].pose, rtol=0, atol=1e-9) for step in steps[:-1])


def scatter(steps: Sequence[Step], settings: LoopSettings, pivot: float) -> Array | None:
    """The scatter of the last looks, once moving brings the camera no nearer.

    Every move was meant to bring it to the reference; where the last ones were to go a part of the
    way alone, nothing is known of the robot. What is seen after them is the scatter of the robot
    and the noise of the estimates. When four looks of the finest stage in a row do not
    shrink, and none is farther than a robot may miss by, this is all there is. The noise is left
    out as far as several images from one pose have shown it.

    Returns
    -------
    ndarray of shape (6,) or None
        Of the robot about the pivot, [m] and [rad], as a root mean square, 0 where noise explains
        what is seen; None while the camera still comes nearer.
    """
    after_moves = [
        (before, step)
        for before, step in zip((None, *steps), steps, strict=False)
        if before is None or before.executed is not None
    ][-_FLOOR_LOOKS:]
    if not all(before is None or _is_whole(before, pivot) for before, _ in after_moves[1:]):
        return None
    last = [step.estimate for _, step in after_moves]
    if len(last) < _FLOOR_LOOKS or not all(
        estimate.is_finest and is_at_hand(estimate.displacement, settings) for estimate in last
    ):
        return None
    displacements = np.stack([estimate.displacement for estimate in last])
    distances, angles = pose_error(np.eye(4), displacements)
    sizes = np.hypot(distances, pivot * angles)
    if sizes[2:].max() < _FLOOR_SHRINKAGE * sizes[:2].max():
        return None
    delta_p = displacements_from_poses(np.eye(4), displacements[1:], pivot)
    seen = np.mean(delta_p**2, axis=0)
    noise = np.mean(_noise([step for _, step in after_moves], settings, pivot)[1:], axis=0)
    is_noisy = np.isfinite(noise) & (noise > 0)
    if is_noisy.any() and np.mean((seen / noise)[is_noisy]) <= _SIGNIFICANT:
        return np.zeros(6)
    return np.sqrt(np.maximum(seen - np.where(is_noisy, noise, 0.0), 0.0))


def _noise(steps: Sequence[Step], settings: LoopSettings, pivot: float) -> Array:
    """Variance of each look by the noise of its images, (n_looks, 6); 0 where nothing shows it."""
    n_images = settings.final_images
    of_means = [
        _noise_of_mean(step.first_displacement, step.estimate, n_images, pivot)
        for step in steps
        if step.first_displacement is not None
    ]
    if not of_means:
        return np.zeros((len(steps), 6))
    n_averaged = [1 if step.first_displacement is None else n_images for step in steps]
    one_image = n_images * np.mean(of_means, axis=0)
    return np.asarray(one_image / np.array(n_averaged)[:, None])


def _is_whole(step: Step, pivot: float) -> bool:
    """Whether the move after a look was to bring the camera all the way to the reference."""
    if step.commanded is None:
        return False
    D = step.estimate.displacement
    (asked, angle), (left, angle_left) = (
        pose_error(np.eye(4), D),
        pose_error(np.eye(4), D @ step.commanded),
    )
    rest, way = np.hypot(left, pivot * angle_left), np.hypot(asked, pivot * angle)
    return bool(rest <= max(_PART * way, 1e-9))


def _is_noise(estimate: Estimate, pivot: float, settings: LoopSettings) -> bool:
    """Whether what is believed is no more than noise.

    An estimate scatters by its own deviation about an error that is as large, left by the
    estimate before: by 1.4 deviations, where only noise is left.
    """
    delta_p = displacements_from_poses(np.eye(4), estimate.displacement[None], pivot)[0]
    std = np.hypot(estimate.std, settings.repeatability(pivot))
    known = np.isfinite(std) & (std > 0)
    if not known.any():
        return False
    if np.sqrt(np.mean((delta_p[known] / std[known]) ** 2)) > settings.noise_limit:
        return False
    significant = np.where(known, 0.0, delta_p)
    return is_within_tolerance(
        poses_from_displacements(np.eye(4), significant[None], pivot)[0], settings, pivot
    )
