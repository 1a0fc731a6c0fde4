import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.metrics.cluster import contingency_matrix, expected_mutual_information

from servoscope.errors import InvalidInputError
from servoscope.selection.bias import CORRECTIONS, corrected_mutual_information, information_bias
from servoscope.selection.binning import bin_codes
from servoscope.selection.mutual_information import mutual_information
from servoscope.selection.surrogates import rearrangements


def entropy(*codes):
    """Plug-in entropy and number of occupied cells, by numpy."""
    counts = np.unique(np.stack(codes), axis=1, return_counts=True)[1]
    p = counts / counts.sum()
    return -np.sum(p * np.log2(p)), len(counts)


@pytest.mark.parametrize("correction", CORRECTIONS)
@pytest.mark.parametrize(("n_samples", "n_bins"), [(1000, 10), (2000, 6)])
def test_unrelated_variables_have_no_information_on_the_average(correction, n_samples, n_bins):
    rng = np.random.default_rng(1)
    X, Y = rng.uniform(size=(n_samples, 30)), rng.uniform(size=(n_samples, 30))
    raw = mutual_information(X, Y, n_bins).mean()
    corrected = corrected_mutual_information(X, Y, n_bins, correction)
    assert abs(corrected.mean()) < 0.06 * raw
    assert (corrected < 0).mean() == pytest.approx(0.53, abs=0.07)


def test_miller_madow_is_the_sum_of_the_corrections_of_the_entropies(rng):
    X = rng.normal(size=(300, 3)) @ rng.normal(size=(3, 4))
    y = X[:, 0] + rng.normal(size=300)
    per_cell = 1 / (2 * 300 * np.log(2))
    (b,) = bin_codes(y[:, None])
    for i, a in enumerate(bin_codes(X)):
        corrected = [h + (k - 1) * per_cell for h, k in (entropy(a), entropy(b), entropy(a, b))]
        expected = corrected[0] + corrected[1] - corrected[2]
        assert corrected_mutual_information(X, y)[i] == pytest.approx(expected, abs=1e-12)


def test_miller_madow_raises_what_a_variable_tells_of_itself(rng):
    x = rng.uniform(size=(500, 1))
    assert information_bias(x, x)[0, 0] == pytest.approx(-9 / (2 * 500 * np.log(2)))


def test_related_gaussians_come_nearer_to_many_samples_by_miller_madow():
    rng = np.random.default_rng(2)

    def drawn(n):
        x = rng.normal(size=(n, 20))
        y = 0.8 * x + 0.6 * rng.normal(size=(n, 20))
        # The range that the bins divide is the same for every number of samples.
        return np.clip(x, -2, 2), np.clip(y, -2, 2)

    truth = mutual_information(*drawn(100_000)).diagonal().mean()
    few = drawn(500)
    raw = mutual_information(*few).diagonal().mean()
    corrected = corrected_mutual_information(*few).diagonal().mean()
    assert abs(corrected - truth) < 0.4 * abs(raw - truth)


def test_bias_of_a_constant_is_none(rng):
    X = np.column_stack([np.ones(100), rng.normal(size=100)])
    for correction in CORRECTIONS:
        bias = information_bias(X, X[:, 1], correction=correction)
        assert bias[0] == 0
        assert bias[1] != 0


@given(st.integers(1, 90), st.integers(2, 9), st.integers(2, 9), st.integers(0, 99))
def test_the_mean_over_permutations_is_that_of_scikit_learn(n_samples, n_a, n_b, seed):
    rng = np.random.default_rng(seed)
    X, y = rng.integers(0, n_a, (n_samples, 1)), rng.integers(0, n_b, n_samples) ** 2
    a, b = bin_codes(X, 9)[0], bin_codes(y[:, None], 9)[0]
    table = contingency_matrix(a, b)
    expected = expected_mutual_information(table, n_samples) / np.log(2)
    assert information_bias(X, y, 9, "permutation")[0] == pytest.approx(expected, abs=1e-10)


def test_the_mean_over_permutations_is_that_of_shuffled_targets(rng):
    X, y = rng.exponential(size=(200, 3)), rng.normal(size=200)
    shuffled = [mutual_information(X, y[o]) for o in rearrangements(200, "shuffle", 2000)]
    expected = np.mean(shuffled, axis=0)
    np.testing.assert_allclose(information_bias(X, y, 10, "permutation"), expected, rtol=0.02)


def test_the_mean_over_permutations_of_many_samples_is_that_of_chi_square(rng):
    X, y = rng.uniform(size=(100_000, 2)), rng.uniform(size=100_000)
    means = (information_bias(X, y, 10, c) for c in ("permutation", "chi_square"))
    np.testing.assert_allclose(*means, rtol=0.002)


def test_an_unknown_correction_is_refused(rng):
    with pytest.raises(InvalidInputError, match="miller_madow, chi_square, permutation, got 'jack"):
        information_bias(rng.normal(size=(9, 1)), np.arange(9), correction="jackknife")
