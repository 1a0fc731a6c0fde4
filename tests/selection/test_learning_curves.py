from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from servoscope.errors import InvalidInputError
from servoscope.kernels import KernelPosterior, fit_kernel
from servoscope.selection import forecast_errors
from servoscope.selection.learning_curves import fit_power_law, learning_curve

SIZES = np.array([75, 150, 300, 450, 600])


@pytest.mark.parametrize(("remainder", "exponent"), [(0.0, 0.5), (0.04, 1.0), (0.05, 1.5)])
def test_an_exact_power_law_is_gone_on_with(remainder, exponent):
    def curve(n):
        return remainder + 0.3 * (n / 75) ** -exponent

    law = fit_power_law(SIZES, curve(SIZES), [0.01] * 5)
    for n in (600, 1200, 3000):
        low, middle, high = law.quantiles(n, [0.05, 0.5, 0.95])
        assert middle == pytest.approx(curve(n), rel=0.08)
        assert low <= 1.03 * curve(n)
        assert high >= 0.97 * curve(n)


def test_the_remainder_is_separated_from_what_still_falls():
    law = fit_power_law(SIZES, 0.05 + 0.3 * (SIZES / 75) ** -1.5, [0.01] * 5)
    share = 0.05 / (0.05 + 0.3 * 8**-1.5)
    assert np.average(law.remainder, weights=law.weight) == pytest.approx(share, abs=0.08)


def test_errors_that_do_not_fall_any_more_are_expected_to_stay():
    law = fit_power_law(SIZES, [0.4, 0.2, 0.2, 0.2, 0.2], [0.02] * 5)
    assert law.quantiles(6000, [0.5])[0] > 0.17


def test_what_is_far_away_is_less_sure_than_what_is_near():
    law = fit_power_law(SIZES, 3 / np.sqrt(SIZES), [0.05] * 5)
    near, far = (np.diff(np.log(law.quantiles(n, [0.05, 0.95]))) for n in (600, 6000))
    assert far > 2 * near


def test_ninety_percent_of_noisy_curves_are_held():
    held = 0
    for seed in range(200):
        rng = np.random.default_rng(seed)
        remainder, exponent = rng.uniform(0, 1), np.exp(rng.uniform(*np.log([0.15, 2.0])))

        def curve(n, a=remainder, c=exponent):
            return (1 - a) * (n / 600) ** -c + a

        law = fit_power_law(SIZES, curve(SIZES) * np.exp(rng.normal(0, 0.05, 5)), [0.05] * 5)
        low, high = law.quantiles(3000, [0.05, 0.95])
        held += low <= curve(3000) <= high
    assert 0.83 < held / 200 < 0.97


@given(
    st.lists(st.floats(1e-6, 1e6), min_size=3, max_size=5),
    st.floats(1, 1e4),
    st.floats(1, 10),
)
def test_errors_never_rise_with_images_whatever_was_measured(rms, n, factor):
    law = fit_power_law(np.arange(1, len(rms) + 1) * 50.0, rms, [0.05] * len(rms))
    fewer, more = (law.quantiles(m, [0.05, 0.5, 0.95]) for m in (n, n * factor))
    assert (more <= fewer * (1 + 1e-12)).all()
    assert (np.diff(fewer) >= 0).all()


def samples(n, seed=0, noise=0.1):
    rng = np.random.default_rng(seed)
    X = rng.uniform(-1, 1, (n, 4))
    return X, np.sin(2 * X[:, 0]) * X[:, 1] + X[:, 2] ** 2 + rng.normal(0, noise, n)


def reached(X, y, X_new, y_new):
    return np.sqrt(np.mean((KernelPosterior(fit_kernel(X, y), X, y).mean(X_new) - y_new) ** 2))


@cache
def curve_of(n, noise=0.05):
    return learning_curve(*samples(n, noise=noise))


def test_it_says_what_twice_and_four_times_the_images_reach():
    curve = curve_of(160)
    X_new, y_new = samples(1000, seed=7, noise=0.05)
    for n in (320, 640):
        X_more, y_more = samples(n, seed=3, noise=0.05)
        rms, interval = curve.rms_at(n)
        truth = reached(X_more, y_more, X_new, y_new)
        assert rms[0] == pytest.approx(truth, rel=0.25)
        assert interval[0, 0] <= truth <= interval[1, 0]


def test_the_sizes_are_shares_of_the_samples_and_errors_fall_with_them():
    curve = curve_of(160)
    assert curve.n_images.tolist() == [20, 40, 80, 120, 160]
    assert curve.rms.shape == (5, 1)
    assert (curve.rms[0] > curve.rms[-1]).all()
    np.testing.assert_array_equal(curve.rms[-1], curve.forecast.rms)


def test_few_samples_are_cut_into_quarters():
    assert curve_of(40).n_images.tolist() == [10, 20, 30, 40]


def test_groups_stay_together():
    X, y = samples(80)
    curve = learning_curve(X, y, groups=np.arange(80) // 16)
    assert curve.n_images.tolist() == [20, 40, 60, 80]


def test_the_images_for_a_tolerance_are_those_at_which_it_is_reached():
    curve = curve_of(80, 0.02)
    tolerance = 0.8 * curve.rms_at(80).rms[0]
    (n,) = curve.images_for(tolerance)
    assert curve.rms_at(n).rms[0] <= tolerance < curve.rms_at(n - 1).rms[0]


def test_no_number_of_images_takes_noise_away():
    assert curve_of(80, 0.3).images_for([0.03]) == [None]


def test_a_target_that_never_changes_needs_no_images():
    X, y = samples(80)
    curve = learning_curve(X, np.column_stack([np.full(80, 0.3), y]))
    assert curve.rms_at(160).rms[0] == 0
    assert curve.images_for([0.001, 1.0]) == [20, 20]


@pytest.mark.parametrize(
    ("n", "groups", "message"),
    [(39, None, "at least 40 samples, got 39"), (40, np.zeros(40), "at least 4 groups")],
)
def test_too_little_is_named_in_one_line(n, groups, message):
    with pytest.raises(InvalidInputError, match=message):
        learning_curve(*samples(n), groups=groups)


@pytest.mark.parametrize("n_images", [9, 4001, float("nan")])
def test_numbers_of_images_out_of_reach_are_refused(n_images):
    curve = curve_of(40)
    with pytest.raises(InvalidInputError, match="n_images must be from 10 to 4000"):
        curve.rms_at(n_images)


def test_a_forecast_that_is_known_is_not_made_again(monkeypatch):
    rng = np.random.default_rng(0)
    X = 50 + 7 * rng.uniform(-1, 1, (60, 2))
    y = 1e-3 * (X.sum(axis=1) + rng.normal(0, 0.5, 60))
    known = forecast_errors(X, y, max_iter=10)
    curve = learning_curve(X, y, n_draws=2, max_iter=10)
    monkeypatch.setattr("servoscope.selection.learning_curves.forecast_errors", None)
    again = learning_curve(X, y, n_draws=2, max_iter=10, whole=known)
    np.testing.assert_allclose(again.rms, curve.rms, rtol=1e-9)
    np.testing.assert_allclose(again.forecast.rms, known.rms, rtol=1e-12)
    assert again.rms_at(120).rms == pytest.approx(curve.rms_at(120).rms)
