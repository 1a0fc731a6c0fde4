import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from sklearn.metrics import mutual_info_score

from servoscope.errors import InvalidInputError
from servoscope.selection.binning import bin_codes
from servoscope.selection.mutual_information import mutual_information, pairwise_mutual_information

tables = hnp.arrays(
    float,
    st.tuples(st.integers(1, 80), st.integers(1, 5)),
    elements=st.floats(-100, 100) | st.integers(-3, 3).map(float),
)


def by_scikit_learn(X, Y, n_bins):
    a, b = bin_codes(X, n_bins), bin_codes(Y, n_bins)
    return np.array([[mutual_info_score(i, j) for j in b] for i in a]) / np.log(2)


@given(tables, st.integers(2, 30))
def test_information_is_that_of_scikit_learn_on_the_same_bins(X, n_bins):
    expected = by_scikit_learn(X, X[:, :2], n_bins)
    np.testing.assert_allclose(mutual_information(X, X[:, :2], n_bins), expected, atol=1e-12)


@given(tables, st.integers(2, 30))
def test_pairwise_information_is_that_of_scikit_learn_on_the_same_bins(X, n_bins):
    expected = by_scikit_learn(X, X, n_bins)
    np.testing.assert_allclose(pairwise_mutual_information(X, n_bins), expected, atol=1e-12)


@pytest.mark.parametrize("n_bins", [2, 10, 11, 64, 256])
def test_information_of_many_samples_is_that_of_scikit_learn(rng, n_bins):
    X = rng.normal(size=(20_000, 4)) @ rng.normal(size=(4, 5))
    expected = by_scikit_learn(X, X, n_bins)
    np.testing.assert_allclose(pairwise_mutual_information(X, n_bins), expected, atol=1e-12)
    np.testing.assert_allclose(mutual_information(X, X, n_bins), expected, atol=1e-12)


@given(tables, st.integers(2, 30))
def test_pairwise_information_is_symmetric_and_bounded_by_the_entropies(X, n_bins):
    information = pairwise_mutual_information(X, n_bins)
    entropy = information.diagonal()
    np.testing.assert_array_equal(information, information.T)
    assert (information >= 0).all()
    assert (information <= np.minimum.outer(entropy, entropy) + 1e-12).all()
    assert (entropy <= np.log2(n_bins) + 1e-12).all()


@given(tables, st.integers(2, 30), st.sampled_from([-1.0, 0.3, 250.0]))
def test_a_constant_feature_or_target_has_exactly_no_information(X, n_bins, constant):
    with_constant = np.column_stack([X, np.full(len(X), constant)])
    assert (mutual_information(X, with_constant, n_bins)[:, -1] == 0).all()
    assert (mutual_information(with_constant, X, n_bins)[-1] == 0).all()
    assert (pairwise_mutual_information(with_constant, n_bins)[-1] == 0).all()


@pytest.mark.parametrize(("n_samples", "n_bins"), [(300, 200), (999, 10), (100_003, 10)])
def test_a_constant_has_exactly_no_information_whatever_rounding_does(rng, n_samples, n_bins):
    X = rng.uniform(size=(n_samples, 20))
    constant = np.ones((n_samples, 1))
    assert (mutual_information(X, constant, n_bins) == 0).all()
    assert (mutual_information(constant, X, n_bins) == 0).all()


@pytest.mark.parametrize("half", [4095, 4096, 4097, 50_000])
def test_counts_of_every_size_are_weighed_alike(half):
    x = np.repeat([0.0, 1.0], half)
    assert pairwise_mutual_information(x[:, None], 2)[0, 0] == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("n_bins", [2, 10, 20])
def test_evenly_spread_values_tell_all_about_themselves(n_bins):
    x = np.arange(1000.0 * n_bins)
    assert mutual_information(x[:, None], x, n_bins)[0] == pytest.approx(np.log2(n_bins), abs=1e-12)


@pytest.mark.parametrize(("n_samples", "n_bins"), [(1000, 10), (5000, 10), (5000, 20)])
def test_unrelated_variables_show_the_bias_of_the_estimate(n_samples, n_bins):
    rng = np.random.default_rng(5)
    X, Y = rng.uniform(size=(n_samples, 40)), rng.uniform(size=(n_samples, 40))
    bias = (n_bins - 1) ** 2 / (2 * n_samples * np.log(2))
    assert mutual_information(X, Y, n_bins).mean() == pytest.approx(bias, rel=0.05)


def test_correlated_gaussians_approach_their_closed_form():
    rng = np.random.default_rng(6)
    x, noise = rng.normal(size=(2, 400_000))
    y = 0.9 * x + np.sqrt(1 - 0.9**2) * noise
    closed_form = -0.5 * np.log2(1 - 0.9**2)
    assert mutual_information(x[:, None], y, 60)[0] == pytest.approx(closed_form, rel=0.02)


@given(st.permutations(range(10)))
def test_renaming_the_bins_preserves_information(names):
    rng = np.random.default_rng(7)
    x = rng.integers(0, 10, 500)
    y = np.concatenate([np.arange(10), (x[10:] + rng.integers(0, 3, 490)) % 10])
    x[:10] = np.arange(10)
    expected = mutual_information(x[:, None], y)
    np.testing.assert_allclose(mutual_information(np.array(names)[x][:, None], y), expected)


def test_a_single_target_gives_the_column_of_that_target(rng):
    X, Y = rng.normal(size=(300, 4)), rng.normal(size=(300, 3))
    assert mutual_information(X, Y).shape == (4, 3)
    np.testing.assert_array_equal(mutual_information(X, Y[:, 1]), mutual_information(X, Y)[:, 1])


def test_a_single_sample_tells_nothing():
    assert mutual_information([[3.0, 4.0]], [1.0]).tolist() == [0.0, 0.0]
    assert (pairwise_mutual_information([[3.0, 4.0]]) == 0).all()


@settings(max_examples=20)
@given(tables)
def test_the_order_of_samples_does_not_matter(X):
    shuffled = np.random.default_rng(8).permutation(X)
    np.testing.assert_array_equal(
        pairwise_mutual_information(X), pairwise_mutual_information(shuffled)
    )


def test_different_numbers_of_samples_are_refused():
    with pytest.raises(InvalidInputError, match="as many samples, got 5 and 4"):
        mutual_information(np.zeros((5, 2)), np.zeros(4))


def test_a_target_that_is_not_finite_is_refused():
    with pytest.raises(InvalidInputError, match="y must be finite"):
        mutual_information(np.zeros((3, 2)), [0.0, np.nan, 1.0])


def test_a_scalar_target_is_refused():
    with pytest.raises(InvalidInputError, match="y must be a table"):
        mutual_information(np.zeros((3, 2)), 1.0)
