import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.signal import lfilter
from scipy.stats import chi2, chi2_contingency
from sklearn.metrics import mutual_info_score
from sklearn.metrics.cluster import contingency_matrix, expected_mutual_information

from servoscope.errors import InvalidInputError
from servoscope.selection.estimators import (
    CORRECTIONS,
    corrected_mutual_information,
    information_bias,
    information_test,
    mutual_information,
    pairwise_mutual_information,
)
from servoscope.selection.histograms import bin_codes

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
def test_evenly_spread_values_share_all_with_themselves(n_bins):
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


def test_a_single_sample_shows_no_information():
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


def test_miller_madow_raises_the_entropy_of_a_variable(rng):
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


def test_an_unknown_correction_is_refused(rng):
    with pytest.raises(InvalidInputError, match="miller_madow, permutation, got 'jack"):
        information_bias(rng.normal(size=(9, 1)), np.arange(9), correction="jackknife")


def sequences(rng, n_samples, n):
    """Sequences that resemble themselves for about 20 samples, and are not related."""
    drawn = lfilter([1.0], [1.0, -0.95], rng.normal(size=(n_samples + 200, n)), axis=0)
    return drawn[200:]


def rate(test):
    """Share of the unrelated variables that a test at 5 % takes for related."""
    return (test.p_values <= 0.05).mean()


@pytest.mark.parametrize("null", ["chi_square", "shifts"])
def test_unrelated_samples_are_rejected_at_the_nominal_rate(null):
    rng = np.random.default_rng(3)
    X, Y = rng.uniform(size=(600, 30)), rng.uniform(size=(600, 30))
    test = information_test(X, Y, 6, null=null, n_shifts=199)
    assert rate(test) == pytest.approx(0.05, abs=0.022)
    assert not test.significant.any()


def test_unrelated_sequences_are_rejected_at_the_nominal_rate_by_shifts():
    rng = np.random.default_rng(4)
    X, Y = sequences(rng, 500, 40), sequences(rng, 500, 40)
    test = information_test(X, Y, 6, null="shifts", n_shifts=99)
    assert rate(test) == pytest.approx(0.05, abs=0.03)


def test_unrelated_sequences_are_mostly_rejected_as_if_their_samples_were_independent():
    rng = np.random.default_rng(5)
    X, Y = sequences(rng, 500, 15), sequences(rng, 500, 15)
    assert rate(information_test(X, Y, 6)) > 0.7


def test_chi_square_p_values_are_those_of_the_scaled_likelihood_ratio_of_scipy(rng):
    X = rng.normal(size=(400, 5))
    y = 0.15 * X[:, 0] + rng.normal(size=400)
    test = information_test(X, y, 7)
    (b,) = bin_codes(y[:, None], 7)
    for i, a in enumerate(bin_codes(X, 7)):
        table = np.zeros((7, 7), int)
        np.add.at(table, (a, b), 1)
        table = table[table.any(axis=1)][:, table.any(axis=0)]
        found = chi2_contingency(table, lambda_="log-likelihood")
        mean = expected_mutual_information(table, 400)
        scaled = found.statistic * found.dof / (800 * mean)
        assert test.p_values[i] == pytest.approx(chi2.sf(scaled, found.dof), rel=1e-6)
        assert test.null_mean[i] == pytest.approx(mean / np.log(2))


@pytest.mark.parametrize("draw", ["uniform", "normal", "exponential"])
@pytest.mark.parametrize(("n_samples", "n_bins"), [(160, 10), (1000, 20)])
def test_few_samples_a_cell_are_no_obstacle(draw, n_samples, n_bins):
    rng = np.random.default_rng(8)
    X, Y = (getattr(rng, draw)(size=(n_samples, 30)) for _ in range(2))
    assert 0.01 < rate(information_test(X, Y, n_bins)) < 0.08


def test_p_values_of_shifts_count_what_is_as_much():
    # Of the 3 shifts only the one by half turns x into a copy of itself.
    x = np.array([0.0, 0.0, 1.0, 1.0])
    assert information_test(x[:, None], x, 2, null="shifts").p_values[0] == 2 / 4


@pytest.mark.parametrize("related", [0.25, 0.5])
def test_p_values_beyond_the_shifts_go_on_as_chi_square(related):
    x, noise = np.random.default_rng(9).uniform(size=(2, 800))
    X, y = x[:, None], related * x + noise
    by_shifts = information_test(X, y, 6, null="shifts", n_shifts=300).p_values[0]
    by_chi_square = information_test(X, y, 6).p_values[0]
    assert by_chi_square < 1e-3
    assert np.log(by_shifts) == pytest.approx(np.log(by_chi_square), rel=0.2)


def test_a_short_sequence_can_show_one_feature_among_many():
    rng = np.random.default_rng(10)
    X, Y = sequences(rng, 200, 60), sequences(rng, 200, 3)
    X[:, 5] = Y[:, 1] + 0.3 * rng.normal(size=200)
    found = information_test(X, Y, 6, null="shifts").significant
    assert found[5, 1]
    assert found.sum() <= 3


def test_what_is_found_is_what_is_there():
    rng = np.random.default_rng(6)
    X, Y = rng.normal(size=(500, 32)), rng.normal(size=(500, 6))
    Y[:, 2] += 0.8 * X[:, 7]
    Y[:, 5] += 0.8 * X[:, 31]
    for null in ("chi_square", "shifts"):
        test = information_test(X, Y, null=null, n_shifts=199)
        assert {(7, 2), (31, 5)} <= set(zip(*np.nonzero(test.significant), strict=True))
        assert test.significant.sum() <= 3


def test_findings_are_controlled_over_all_features_and_targets_together():
    rng = np.random.default_rng(7)
    X, Y = rng.uniform(size=(500, 100)), rng.uniform(size=(500, 6))
    test = information_test(X, Y, 5)
    assert (test.p_values <= 0.05).any(axis=0).all()
    assert not test.significant.any()


def test_information_is_the_raw_one_and_corrected_less_the_mean_of_chance(rng):
    X, y = rng.normal(size=(300, 3)), rng.normal(size=300)
    test = information_test(X, y)
    np.testing.assert_array_equal(test.information, mutual_information(X, y))
    np.testing.assert_allclose(test.corrected + test.null_mean, test.information)


@pytest.mark.parametrize("null", ["chi_square", "shifts"])
def test_a_constant_is_never_significant(rng, null):
    X = np.column_stack([np.ones(120), rng.normal(size=120)])
    test = information_test(X, X, null=null, n_shifts=199)
    assert test.p_values[0].tolist() == [1, 1]
    assert test.significant.tolist() == [[False, False], [False, True]]


def test_a_single_sample_shows_nothing():
    for null in ("chi_square", "shifts"):
        test = information_test([[1.0]], [2.0], null=null, n_shifts=2)
        assert test.p_values.tolist() == [1.0]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"null": "bayes"}, "one of chi_square, shifts, got 'bayes'"),
        ({"level": 0.0}, "level must be between 0 and 1"),
        ({"n_shifts": 0}, "n_shifts must be 1 or more, got 0"),
    ],
)
def test_bad_input_is_refused(arguments, message):
    with pytest.raises(InvalidInputError, match=message):
        information_test(np.zeros((5, 1)), np.zeros(5), **arguments)
