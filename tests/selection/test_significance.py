import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import chi2, chi2_contingency
from sklearn.metrics.cluster import expected_mutual_information

from servoscope.errors import InvalidInputError
from servoscope.selection.binning import bin_codes
from servoscope.selection.mutual_information import mutual_information
from servoscope.selection.significance import information_test


def sequences(rng, n_samples, n):
    """Sequences that resemble themselves for about 20 samples, and are not related."""
    drawn = lfilter([1.0], [1.0, -0.95], rng.normal(size=(n_samples + 200, n)), axis=0)
    return drawn[200:]


def rate(test):
    """Share of the unrelated variables that a test at 5 % takes for related."""
    return (test.p_values <= 0.05).mean()


@pytest.mark.parametrize("null", ["chi_square", "shuffle", "shifts", "blocks"])
def test_unrelated_samples_are_rejected_at_the_nominal_rate(null):
    rng = np.random.default_rng(3)
    X, Y = rng.uniform(size=(600, 30)), rng.uniform(size=(600, 30))
    test = information_test(X, Y, 6, null=null, n_permutations=199, block_length=10)
    assert rate(test) == pytest.approx(0.05, abs=0.022)
    assert not test.significant.any()


@pytest.mark.parametrize("null", ["shifts", "blocks"])
def test_unrelated_sequences_are_rejected_at_the_nominal_rate_when_kept_in_order(null):
    rng = np.random.default_rng(4)
    rates = [
        rate(
            information_test(
                sequences(rng, 500, 15),
                sequences(rng, 500, 15),
                6,
                null=null,
                n_permutations=99,
                block_length=100,
            )
        )
        for _ in range(5)
    ]
    assert np.mean(rates) == pytest.approx(0.05, abs=0.03)


@pytest.mark.parametrize("null", ["chi_square", "shuffle"])
def test_unrelated_sequences_are_mostly_rejected_as_if_their_samples_were_independent(null):
    rng = np.random.default_rng(5)
    X, Y = sequences(rng, 500, 15), sequences(rng, 500, 15)
    assert rate(information_test(X, Y, 6, null=null, n_permutations=99)) > 0.7


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


def test_permutation_p_values_count_what_is_as_much():
    # Only 2 of the 4! orders of the target tell all of x.
    x = np.array([0.0, 0.0, 1.0, 1.0])
    test = information_test(x[:, None], x, 2, null="shuffle", n_permutations=4000)
    assert test.p_values[0] == pytest.approx(1 / 3, abs=0.03)
    assert information_test(x[:, None], x, 2, null="shifts").p_values[0] == 2 / 4


@pytest.mark.parametrize("related", [0.25, 0.35, 0.5])
def test_p_values_beyond_the_permutations_go_on_as_chi_square(related):
    x, noise = np.random.default_rng(9).uniform(size=(2, 800))
    X, y = x[:, None], related * x + noise
    by_permutation = information_test(X, y, 6, null="shuffle", n_permutations=300).p_values[0]
    by_chi_square = information_test(X, y, 6).p_values[0]
    assert by_chi_square < 1e-3
    assert np.log(by_permutation) == pytest.approx(np.log(by_chi_square), rel=0.2)


def test_a_short_sequence_can_tell_one_feature_among_many():
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
    for null in ("chi_square", "shuffle"):
        test = information_test(X, Y, null=null, n_permutations=199)
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


@pytest.mark.parametrize("null", ["chi_square", "shuffle", "shifts"])
def test_a_constant_is_never_significant(rng, null):
    X = np.column_stack([np.ones(120), rng.normal(size=120)])
    test = information_test(X, X, null=null, n_permutations=199)
    assert test.p_values[0].tolist() == [1, 1]
    assert test.significant.tolist() == [[False, False], [False, True]]


def test_a_single_sample_shows_nothing():
    for null in ("chi_square", "shuffle", "shifts"):
        test = information_test([[1.0]], [2.0], null=null, n_permutations=2)
        assert test.p_values.tolist() == [1.0]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"null": "bayes"}, "one of chi_square, shuffle, blocks, shifts, got 'bayes'"),
        ({"level": 0.0}, "level must be between 0 and 1"),
        ({"null": "blocks", "block_length": 4}, "half of the 5 samples, got 4"),
    ],
)
def test_bad_input_is_refused(arguments, message):
    with pytest.raises(InvalidInputError, match=message):
        information_test(np.zeros((5, 1)), np.zeros(5), **arguments)
