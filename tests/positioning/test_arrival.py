"""The camera has arrived within the tolerance, or when noise alone is left."""

import numpy as np
import pytest

from planar import PIVOT, RANGES
from servoscope.poses import inverse_transform, poses_from_displacements, rigid_transform
from servoscope.positioning.arrival import (
    asks_for_a_move,
    is_noise_only,
    is_within_tolerance,
    scatter,
    unread,
)
from servoscope.positioning.interfaces import Estimate
from servoscope.positioning.result import Step
from servoscope.positioning.settings import LoopSettings


def _estimate(delta_p, std, stage: str = "fine") -> Estimate:
    displacement = poses_from_displacements(np.eye(4), np.asarray(delta_p, dtype=float), PIVOT)
    return Estimate(displacement, np.broadcast_to(std, 6), np.nan, stage)


def test_both_tolerances_count() -> None:
    limits = LoopSettings(tolerance_mm=1, tolerance_deg=0.1)
    turn = _estimate([0, 0, 0, 0, 0, np.radians(0.11)], 0).displacement
    assert is_within_tolerance(rigid_transform(np.eye(3), [0.99e-3, 0, 0]), limits)
    assert not is_within_tolerance(rigid_transform(np.eye(3), [0.8e-3, 0.8e-3, 0]), limits)
    assert not is_within_tolerance(turn, limits)


@pytest.mark.parametrize(("deviations", "noise"), [(1.9, True), (2.1, False)])
def test_two_standard_deviations_twice_are_noise(deviations: float, noise: bool) -> None:
    std = 0.01 * RANGES
    estimate = _estimate(deviations * std * [1, -1, 1, -1, 1, -1], std)
    assert is_noise_only([estimate] * 2, PIVOT, LoopSettings()) == noise
    assert not is_noise_only([estimate], PIVOT, LoopSettings())


def test_one_dof_that_is_off_by_far_is_not_noise() -> None:
    std = 0.01 * RANGES
    estimate = _estimate(5 * std * [0, 0, 1, 0, 0, 0], std)
    assert not is_noise_only([estimate] * 2, PIVOT, LoopSettings())


def test_a_change_of_stage_is_waited_for() -> None:
    coarse, fine = (_estimate(np.zeros(6), RANGES, stage) for stage in ("coarse", "fine"))
    assert is_noise_only([coarse, fine, fine], PIVOT, LoopSettings())
    assert not is_noise_only([coarse, coarse, fine], PIVOT, LoopSettings())


def test_a_dof_of_which_nothing_is_believed_has_to_be_within_the_tolerance() -> None:
    std = np.where(np.arange(6) == 2, np.nan, 0.1 * RANGES)
    near, far = (_estimate(0.05 * RANGES * [1, 1, tz, 1, 1, 1], std) for tz in (0.01, 1))
    assert is_noise_only([near] * 2, PIVOT, LoopSettings())
    assert not is_noise_only([far] * 2, PIVOT, LoopSettings())
    assert not is_noise_only([_estimate(0 * RANGES, np.nan)] * 2, PIVOT, LoopSettings())


def test_the_scatter_of_the_robot_is_noise_too() -> None:
    scatter = {"repeatability_mm": 0.1, "repeatability_deg": 0.02}
    sideways = 1e-3 * np.hypot(0.1, 550 * np.radians(0.02))
    expected = np.array([sideways, sideways, 1e-4, *[np.radians(0.02)] * 3])
    for share, noise in ((1.9, True), (2.1, False)):
        estimate = _estimate(share * expected, 1e-9)
        assert is_noise_only([estimate] * 2, PIVOT, LoopSettings(**scatter)) == noise


def test_dofs_that_are_no_better_known_than_the_range_are_not_read() -> None:
    reach = np.array([0.04] * 3 + [0.4] * 3)
    known = [1e-3, 0.3, 1e-3, 0.01, 0.01, 0.5]
    assert unread(_estimate(np.zeros(6), known), reach) == ["ty", "rz"]
    assert unread(_estimate(np.zeros(6), np.nan), reach) == []
    still = np.full(6, 1e-6)  # a dof that never moves has no range to speak of
    assert unread(_estimate(np.zeros(6), 1e-4), still) == []


def test_a_mean_beyond_its_noise_asks_for_a_move_unless_a_tolerance_is_met() -> None:
    noise, believed, n = 0.01 * RANGES, 0.1 * RANGES, 8
    one = noise * np.sqrt(n - 1)  # by as much one image differs from the mean

    def asks(share: float, limits: LoopSettings, scatter=None) -> bool:
        mean, first = (_estimate(share * noise + off, believed) for off in (0, one))
        return asks_for_a_move(first, mean, n, PIVOT, limits, scatter)

    assert asks(1.6, LoopSettings())
    assert not asks(1.4, LoopSettings())
    assert not asks(1.6, LoopSettings(tolerance_mm=50, tolerance_deg=10))
    assert asks(1.6, LoopSettings(tolerance_mm=1e-3))
    assert not asks(1.6, LoopSettings(), 2 * noise)
    still = _estimate(noise, believed)
    assert not asks_for_a_move(still, still, n, PIVOT, LoopSettings(), None)


N_IMAGES, NOISE = 8, 2e-4 * RANGES


def _scatter(robot: float, rng) -> np.ndarray:
    """Of a robot that scatters by so many deviations of one image, over looks of one image each.

    The last look is the mean of several.
    """
    steps = []
    for i in range(5):
        true = robot * NOISE * rng.normal(size=6)
        images = NOISE * rng.normal(size=(N_IMAGES if i == 4 else 1, 6))
        seen = _estimate(true + images.mean(axis=0), 3 * NOISE)
        first = _estimate(true + images[0], NOISE).displacement if i == 4 else None
        moved = inverse_transform(seen.displacement)
        steps.append(Step(np.eye(4), 0.0, seen, moved, moved, 0.0, None, first))
    found = scatter(steps, LoopSettings(final_images=N_IMAGES), PIVOT)
    return np.full(6, np.nan) if found is None else found / NOISE


def test_the_noise_of_single_images_is_no_scatter_of_the_robot() -> None:
    rng = np.random.default_rng(0)
    still, wide = (np.stack([_scatter(s, rng) for _ in range(100)]) for s in (0.0, 8.0))
    assert np.nanmedian(np.sqrt(np.mean(still**2, axis=1))) == 0
    assert np.sqrt(np.nanmean(wide**2)) == pytest.approx(8, rel=0.15)
