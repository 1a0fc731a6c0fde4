import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from servoscope.errors import InvalidInputError
from servoscope.selection.estimators import (
    corrected_mutual_information,
    equal_frequency_information,
    mutual_information,
    quantile_codes,
)

ESTIMATORS = {
    "histogram": mutual_information,
    "corrected_histogram": corrected_mutual_information,
    "equal_frequency": equal_frequency_information,
}


def estimate_information(X, y, estimator="histogram", **options):
    return ESTIMATORS[estimator](X, y, **options)


def gaussian(rng, rho, n_samples):
    x, noise = rng.normal(size=(2, n_samples))
    return x[:, None], rho * x + np.sqrt(1 - rho**2) * noise


@pytest.mark.parametrize("rho", [-0.9, 0.3, 0.6, 0.95])
@pytest.mark.parametrize(
    ("estimator", "options", "n_samples"),
    [
        ("histogram", {"n_bins": 40}, 200_000),
        ("corrected_histogram", {"n_bins": 40}, 200_000),
        ("equal_frequency", {"n_bins": 40}, 200_000),
    ],
)
def test_gaussians_have_the_information_of_their_correlation(estimator, options, n_samples, rho):
    X, y = gaussian(np.random.default_rng(8), rho, n_samples)
    expected = -0.5 * np.log2(1 - rho**2)
    found = estimate_information(X, y, estimator, **options)[0]
    assert found == pytest.approx(expected, rel=0.03, abs=0.02)


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_uniform_variables_that_are_unrelated_have_next_to_none(estimator):
    rng = np.random.default_rng(9)
    found = estimate_information(rng.uniform(size=(3000, 5)), rng.uniform(size=3000), estimator)
    assert abs(found).max() < 0.06


@pytest.mark.parametrize("estimator", ["histogram", "equal_frequency"])
@pytest.mark.parametrize("n_bins", [2, 8, 20])
def test_evenly_spread_values_determine_their_bin(estimator, n_bins):
    x = np.random.default_rng(10).permutation(np.arange(100.0 * n_bins))
    found = estimate_information(x[:, None], -x, estimator, n_bins=n_bins)[0]
    assert found == pytest.approx(np.log2(n_bins), abs=1e-9)


@given(st.sampled_from([np.exp, np.cbrt, np.arctan, lambda x: x**3 + x]), st.integers(0, 9))
def test_growing_functions_change_nothing_of_bins_of_equal_frequency(function, seed):
    X, y = gaussian(np.random.default_rng(seed), 0.7, 150)
    expected = equal_frequency_information(X, y)
    np.testing.assert_array_equal(equal_frequency_information(function(X), y), expected)
    np.testing.assert_array_equal(equal_frequency_information(X, function(y)), expected)


def test_equal_width_bins_do_change(rng):
    X, y = gaussian(rng, 0.7, 500)
    assert estimate_information(np.exp(3 * X), y)[0] < 0.8 * estimate_information(X, y)[0]


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_a_constant_has_no_information(estimator, rng):
    X = np.column_stack([np.full(200, 0.1), rng.normal(size=200)])
    assert estimate_information(X, X[:, 1], estimator)[0] == 0
    assert (estimate_information(X, X[:, 0], estimator) == 0).all()


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_several_targets_give_a_column_each(estimator, rng):
    X, Y = rng.normal(size=(120, 3)), rng.normal(size=(120, 2))
    both = estimate_information(X, Y, estimator)
    assert both.shape == (3, 2)
    np.testing.assert_allclose(both[:, 1], estimate_information(X, Y[:, 1], estimator))


@given(hnp.arrays(float, st.integers(1, 60), elements=st.integers(-9, 9)), st.integers(2, 12))
def test_bins_of_equal_frequency_keep_order_and_ties(x, n_bins):
    (codes,) = quantile_codes(x[:, None], n_bins)
    order = np.argsort(x)
    assert (np.diff(codes[order].astype(int)) >= 0).all()
    assert all(len(set(codes[x == value])) == 1 for value in x)
    assert codes.max() < n_bins


@given(st.integers(1, 200), st.integers(2, 20))
def test_bins_without_ties_hold_equally_many(n_samples, n_bins):
    x = np.random.default_rng(n_samples).permutation(n_samples)
    counts = np.bincount(quantile_codes(x[:, None], n_bins)[0], minlength=n_bins)
    assert counts.max() - counts.min() <= 1


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_samples_that_do_not_fit_are_refused(estimator):
    with pytest.raises(InvalidInputError, match="as many samples, got 9 and 8"):
        estimate_information(np.zeros((9, 1)), np.zeros(8), estimator)
    with pytest.raises(InvalidInputError, match="y must be finite"):
        estimate_information(np.zeros((9, 1)), np.full(9, np.nan), estimator)


ORDINARY = np.random.default_rng(20).normal(size=(2, 400))


@pytest.mark.parametrize("estimator", ESTIMATORS)
@pytest.mark.parametrize("scale", [1e200, 1e-200, 1e-300, -1e8, 3.0])
@pytest.mark.parametrize("offset", [0.0, 1e10])
def test_offset_and_scale_change_nothing(estimator, scale, offset):
    """Up to what rounding at an offset of 1e10, to two parts in a million, does to an edge."""
    x, noise = ORDINARY
    y = x + 0.5 * noise
    expected = estimate_information(x[:, None], y, estimator)
    moved = estimate_information(scale * (x[:, None] + offset), y, estimator)
    np.testing.assert_allclose(moved, expected, atol=1e-9 if scale > 0 and not offset else 0.05)
    moved = estimate_information(x[:, None], scale * (y + offset), estimator)
    np.testing.assert_allclose(moved, expected, atol=1e-9 if scale > 0 and not offset else 0.05)


def entropy(labels):
    p = np.unique(labels, return_counts=True)[1] / len(labels)
    return -np.sum(p * np.log2(p))


@pytest.mark.parametrize("estimator", ESTIMATORS)
@given(
    st.integers(2, 6),
    st.integers(40, 150),
    st.sampled_from(["itself", "mirrored", "noisy", "unrelated"]),
    st.sampled_from([1.0, 1e200, 1e-200]),
    st.integers(0, 999),
)
def test_information_about_a_discrete_variable_is_at_most_its_entropy(
    estimator, n_levels, n_samples, other, scale, seed
):
    rng = np.random.default_rng(seed)
    labels = rng.integers(0, n_levels, n_samples) ** 2
    x = {
        "itself": labels,
        "mirrored": -labels,
        "noisy": labels + 0.1 * rng.normal(size=n_samples),
        "unrelated": rng.normal(size=n_samples),
    }[other]
    for a, b in ((x, labels), (labels, x)):
        found = estimate_information(a[:, None] * scale, b, estimator)[0]
        assert found <= entropy(labels) + 1e-12


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_equal_binary_variables_share_one_bit(estimator):
    x = np.arange(200) % 2
    assert estimate_information(x[:, None], x, estimator)[0] == pytest.approx(1, abs=0.05)


def test_one_huge_value_hides_nothing_from_bins_of_equal_frequency():
    x, noise = ORDINARY
    y = x + 0.5 * noise
    expected = equal_frequency_information(x[:, None], y)[0]
    x = np.where(np.arange(400) == 7, 1e250, x)
    assert equal_frequency_information(x[:, None], y)[0] == pytest.approx(expected, abs=0.2)


@pytest.mark.parametrize("estimator", ESTIMATORS)
@pytest.mark.parametrize(
    "cast",
    [
        np.asfortranarray,
        lambda a: a[::-1][::-1],
        lambda a: a.astype(object),
        lambda a: a.tolist(),
        np.ma.asarray,
    ],
)
def test_how_numbers_are_kept_does_not_matter(estimator, cast, rng):
    X, y = rng.normal(size=(90, 2)), rng.normal(size=90)
    expected = estimate_information(X, y, estimator)
    np.testing.assert_array_equal(estimate_information(cast(X), cast(y), estimator), expected)


@pytest.mark.parametrize("estimator", ESTIMATORS)
@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda a: np.ma.masked_greater(a, 0.5), "hides .* behind a mask"),
        (lambda a: a + 1j, "must be an array of numbers .*complex"),
        (lambda a: a.astype(str), "must be an array of numbers"),
        (lambda a: a.astype("datetime64[s]"), "must be an array of numbers"),
        (lambda a: np.where(a > 0.5, np.nan, a), "must be finite"),
        (lambda a: np.where(a > 0.5, np.inf, a), "must be finite"),
    ],
)
def test_what_are_no_plain_numbers_is_refused(estimator, spoil, message, rng):
    X, y = rng.normal(size=(90, 2)), rng.normal(size=90)
    for arguments in ((spoil(X), y), (X, spoil(y))):
        with pytest.raises(InvalidInputError, match=message):
            estimate_information(*arguments, estimator)


def test_too_few_bins_are_refused():
    with pytest.raises(InvalidInputError, match="n_bins must be an integer"):
        equal_frequency_information(np.zeros((9, 1)), np.zeros(9), n_bins=1)
