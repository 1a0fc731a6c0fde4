import numpy as np
import pytest
from scipy.stats import f, norm

from servoscope.selection.rms_interval import (
    effective_groups,
    rms_interval,
    rms_log_error,
    rms_ratio_interval,
)


def coverage_of(draw, groups, truth, n_trials=600):
    held = 0
    for trial in range(n_trials):
        low, high = rms_interval(draw(np.random.default_rng(trial)), groups)[:, 0]
        held += low <= truth <= high
    return held / n_trials


def test_the_interval_of_independent_normal_residuals_holds_nine_times_in_ten():
    assert coverage_of(lambda rng: rng.normal(0, 2, (200, 1)), None, 2.0) == pytest.approx(
        0.9, abs=0.04
    )


@pytest.mark.parametrize("n_groups", [4, 8])
def test_few_groups_of_residuals_that_are_alike_still_hold_nine_times_in_ten(n_groups):
    groups = np.repeat(np.arange(n_groups), 13)

    def draw(rng):
        shared = rng.uniform(0.8, 1.2, n_groups)[groups]
        return (shared * rng.normal(size=len(groups)))[:, None]

    truth = np.sqrt(np.mean(np.linspace(0.8, 1.2, 10001) ** 2))
    assert coverage_of(draw, groups, truth) == pytest.approx(0.9, abs=0.04)


def test_the_standard_error_of_normal_residuals_is_the_textbook_one():
    residuals = norm.ppf((np.arange(5000) + 0.5) / 5000)[:, None]
    error, n_groups = rms_log_error(residuals)
    assert n_groups == 5000
    assert error[0] == pytest.approx(1 / np.sqrt(2 * 5000), rel=0.01)


def test_single_samples_as_groups_change_nothing():
    residuals = np.random.default_rng(0).normal(size=(50, 2))
    np.testing.assert_allclose(
        rms_interval(residuals, np.arange(50)[::-1]), rms_interval(residuals), rtol=1e-12
    )


def test_residuals_alike_within_groups_make_the_interval_wider():
    rng = np.random.default_rng(0)
    groups = np.repeat(np.arange(20), 10)
    residuals = np.repeat(rng.normal(size=(20, 1)), 10, axis=0)
    single, grouped = rms_interval(residuals), rms_interval(residuals, groups)
    assert np.ptp(grouped) > 2 * np.ptp(single)


def test_residuals_of_zero_have_an_interval_of_zero():
    np.testing.assert_array_equal(rms_interval(np.zeros((10, 1))), [[0.0], [0.0]])


def test_other_errors_widen_the_interval_as_variances_add_up():
    residuals = np.random.default_rng(0).normal(size=(300, 1))
    half = {e: np.log(np.divide(*rms_interval(residuals, None, 0.9, e)[::-1, 0])) for e in (0, 0.1)}
    assert half[0.1] ** 2 - half[0] ** 2 == pytest.approx((2 * norm.ppf(0.95) * 0.1) ** 2)


def normal(rng, shape):
    return np.ones(shape)


def differing(rng, shape):
    """Groups whose errors differ by a factor of 2.2 either way."""
    return np.exp(rng.normal(0, 0.8, shape))


def one_in_five(rng, shape):
    """Every fifth group at random errs four times as much, as if it were far from the others."""
    return np.where(rng.uniform(size=shape) < 0.2, 4.0, 1.0)


N_TRIALS = 50
SIZE = 13


def grouped_trials(scales, n_groups, alike, seed):
    """Residuals of groups, a column each trial: so much of their variance is alike in a group."""
    rng = np.random.default_rng(seed)
    shared = rng.normal(size=(n_groups, 1, N_TRIALS))
    own = rng.normal(size=(n_groups, SIZE, N_TRIALS))
    residuals = np.sqrt(alike) * shared + np.sqrt(1 - alike) * own
    return scales(rng, (n_groups, 1, N_TRIALS)) * residuals


def rms_of(residuals):
    return np.sqrt(np.mean(residuals**2, axis=(0, 1)))


NUMBERS = [(4, 3), (6, 3), (9, 4), (15, 5), (20, 8)]


@pytest.mark.parametrize(
    ("scales", "alike"), [(normal, 0.0), (normal, 0.5), (differing, 0.3), (one_in_five, 0.3)]
)
def test_nine_tests_of_few_groups_in_ten_measure_what_was_said(scales, alike):
    held = []
    for n_learned, n_tested in NUMBERS:
        groups = np.repeat(np.arange(n_learned), SIZE)
        every = grouped_trials(scales, n_learned + n_tested, alike, n_learned)
        known, new = every[:n_learned], every[n_learned:]
        low, high = rms_ratio_interval(known.reshape(-1, N_TRIALS), groups, n_tested)
        ratio = rms_of(new) / rms_of(known)
        held.append((low <= ratio) & (ratio <= high))
    assert 0.84 <= np.mean(held) <= 0.97


@pytest.mark.parametrize(("scales", "spread"), [(normal, 0.0), (differing, 0.8)])
def test_a_measured_rms_is_as_near_to_the_true_one_as_was_said(scales, spread):
    truth, held = np.exp(spread**2), []
    for n_learned, n_tested in NUMBERS:
        groups = np.repeat(np.arange(n_learned), SIZE)
        every = grouped_trials(scales, n_learned + n_tested, 0.3, n_learned)
        known, new = every[:n_learned].reshape(-1, N_TRIALS), every[n_learned:]
        low, high = rms_ratio_interval(known, groups, np.inf, n_tested)
        held.append((low * rms_of(new) <= truth) & (truth <= high * rms_of(new)))
    assert 0.84 <= np.mean(held) <= 0.97


def test_independent_residuals_are_as_far_from_each_other_as_chi_square_says():
    """The F distribution has the ratio of mean squares."""
    residuals = np.random.default_rng(0).normal(size=(240, 40))
    found = rms_ratio_interval(residuals, np.arange(240), 80).mean(axis=1)
    np.testing.assert_allclose(found, np.sqrt(f.ppf([0.05, 0.95], 80, 240)), atol=0.03)


def test_more_groups_on_either_side_make_it_narrower():
    residuals = np.random.default_rng(0).normal(size=(130, 1))
    groups = np.repeat(np.arange(10), 13)
    widths = [
        float(np.ptp(rms_ratio_interval(residuals, groups, new, known)))
        for new, known in ((2, 2), (2, 10), (5, 10), (np.inf, 10), (np.inf, 100))
    ]
    assert widths == sorted(widths, reverse=True)


def test_residuals_of_zero_have_a_ratio_of_one():
    ratios = rms_ratio_interval(np.zeros((12, 1)), np.repeat(np.arange(4), 3), 3)
    np.testing.assert_array_equal(ratios, [[1.0], [1.0]])


def test_one_group_without_error_leaves_the_interval_finite():
    residuals = np.random.default_rng(0).normal(size=(40, 1))
    residuals[:10] = 0
    ratios = rms_ratio_interval(residuals, np.repeat(np.arange(4), 10), 3)
    assert np.isfinite(ratios).all()


@pytest.mark.parametrize(("sizes", "expected"), [([5, 5, 5], 3), ([10], 1), ([9, 1], 100 / 82)])
def test_unequal_groups_count_as_fewer(sizes, expected):
    groups = np.repeat(np.arange(len(sizes)) * 7, sizes)
    assert effective_groups(groups) == pytest.approx(expected)


def test_of_groups_that_are_known_only_the_new_ones_are_uncertain():
    residuals, groups = np.random.default_rng(0).normal(size=(80, 1)), np.repeat(np.arange(8), 10)
    shares = (1.0, 0.5, 0.1, 0.0)
    ends = [np.log(rms_ratio_interval(residuals, groups, 3, share_new=one)) for one in shares]
    widths = [float(high[0] - low[0]) for low, high in ends]
    assert widths == sorted(widths, reverse=True)
    assert widths[-1] == pytest.approx(0, abs=1e-9)
    assert widths[2] == pytest.approx(0.1 * widths[0], rel=0.2)
