import numpy as np
import pytest
from scipy.stats import norm

from servoscope.selection.rms_interval import rms_interval, rms_log_error


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
