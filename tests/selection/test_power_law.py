import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from servoscope.selection.power_law import fit_power_law

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


def test_the_remainder_is_told_from_what_still_falls():
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
