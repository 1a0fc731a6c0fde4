from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import kendalltau

from servoscope.errors import InvalidInputError
from servoscope.selection.candidates import Candidates
from servoscope.selection.estimators import (
    CORRECTIONS,
    corrected_mutual_information,
    mutual_information,
    pairwise_mutual_information,
)
from servoscope.selection.ideal_point import (
    ThresholdSubset,
    best_subset,
    order_stability,
    rank_ideal_point,
    rank_ideal_point_corrected,
    redundancy_bias,
    threshold_subsets,
)


def ranked_literally(relevance, pairwise, n_features):
    """The rule as the paper words it, one candidate at a time."""
    selected, candidates = [], list(range(len(relevance)))
    while candidates and len(selected) < n_features:
        ideal_y = max(relevance[i] for i in candidates)
        distances = {}
        for i in candidates:
            x = sum(pairwise[i][k] for k in selected)
            distances[i] = x * x + (ideal_y - relevance[i]) * (ideal_y - relevance[i])
        chosen = min(candidates, key=lambda i: (distances[i], i))
        selected.append(chosen)
        candidates.remove(chosen)
    return selected


@st.composite
def information(draw):
    n = draw(st.integers(1, 9))
    # Quarters add without rounding, so that ties are ties.
    quarters = st.integers(0, 12).map(lambda k: k / 4)
    relevance = draw(st.lists(quarters, min_size=n, max_size=n))
    half = np.reshape(draw(st.lists(quarters, min_size=n * n, max_size=n * n)), (n, n))
    return np.array(relevance), np.tril(half) + np.tril(half, -1).T


@given(information(), st.integers(1, 12))
def test_order_is_that_of_the_rule_word_by_word(information, n_features):
    order = rank_ideal_point(*information, n_features).order
    assert order.tolist() == ranked_literally(*information, n_features)


def test_order_is_that_of_the_rule_on_measured_information(rng):
    X = rng.normal(size=(600, 5)) @ rng.normal(size=(5, 40)) + rng.normal(size=(600, 40))
    relevance = mutual_information(X, X[:, :3].sum(axis=1))
    pairwise = pairwise_mutual_information(X)
    order = rank_ideal_point(relevance, pairwise, 40).order
    assert order.tolist() == ranked_literally(relevance, pairwise, 40)


def test_the_most_informative_feature_is_first():
    assert rank_ideal_point([0.2, 0.9, 0.5], np.ones((3, 3)), 3).order[0] == 1


def test_a_duplicate_waits_until_what_is_new_has_been_selected(rng):
    X = rng.uniform(size=(2000, 4))
    X[:, 1] = X[:, 0]
    y = X @ [0.5, 0.5, 0.8, 0.4]
    order = rank_ideal_point(mutual_information(X, y), pairwise_mutual_information(X), 4).order
    assert order.tolist() == [0, 2, 3, 1]


def test_equal_candidates_are_taken_in_their_order():
    assert rank_ideal_point(np.ones(5), np.zeros((5, 5)), 5).order.tolist() == [0, 1, 2, 3, 4]


def test_the_greatest_relevance_is_that_of_the_candidates_that_remain():
    # Measured from 1.0, the greatest of all, feature 1 would be nearer at the second step.
    relevance = [1.0, 0.6, 0.3]
    pairwise = np.array([[3.0, 0.5, 0.45], [0.5, 3.0, 0.0], [0.45, 0.0, 3.0]])
    assert rank_ideal_point(relevance, pairwise, 3).order.tolist() == [0, 1, 2]
    relevance[2] = 0.5
    assert rank_ideal_point(relevance, pairwise, 3).order.tolist() == [0, 2, 1]


def test_every_step_keeps_the_plane_that_it_chose_in(rng):
    X = rng.normal(size=(500, 8))
    relevance, pairwise = mutual_information(X, X.sum(axis=1)), pairwise_mutual_information(X)
    ranking = rank_ideal_point(relevance, pairwise, 5)
    for step, chosen in enumerate(ranking.order):
        before = ranking.order[:step]
        candidates = np.setdiff1d(np.arange(8), before)
        plane = ranking.candidate_redundancy[step]
        np.testing.assert_allclose(
            plane[candidates], pairwise[np.ix_(candidates, before)].sum(axis=1), atol=1e-12
        )
        assert np.isnan(plane[before]).all()
        assert ranking.redundancy[step] == plane[chosen]
        assert ranking.relevance[step] == relevance[chosen]


def test_fewer_candidates_than_asked_for_are_all_ranked():
    assert sorted(rank_ideal_point([0.1, 0.2], np.eye(2), 24).order) == [0, 1]


@pytest.mark.parametrize(
    ("relevance", "pairwise", "n_features", "message"),
    [
        ([0.1, 0.2], np.eye(3), 2, "must have the shapes"),
        ([[0.1, 0.2]], np.eye(2), 2, "must have the shapes"),
        ([0.1, np.nan], np.eye(2), 2, "must be finite"),
        ([0.1, 0.2], np.full((2, 2), np.inf), 2, "must be finite"),
        ([], np.zeros((0, 0)), 1, "not empty"),
        ([0.1, 0.2], np.eye(2), 0, "n_features must be 1 or more, got 0"),
    ],
)
def test_bad_input_is_refused(relevance, pairwise, n_features, message):
    with pytest.raises(InvalidInputError, match=message):
        rank_ideal_point(relevance, pairwise, n_features)


@pytest.fixture
def unrelated():
    """Ten features that give a part of the target each, and twelve uninformative bits."""
    rng = np.random.default_rng(1)
    X = np.column_stack([rng.uniform(size=(600, 10)), rng.integers(0, 2, (600, 12))])
    return X, X[:, :10].sum(axis=1)


@pytest.mark.parametrize("correction", CORRECTIONS)
def test_unrelated_features_have_hardly_any_redundancy(unrelated, correction):
    X, y = unrelated
    published = rank_ideal_point(*relevance_and_pairwise(X, y), 10)
    corrected = rank_ideal_point_corrected(Candidates(X, y), 10, correction)
    assert corrected.redundancy[-1] < 0.2 * published.redundancy[-1] + 0.05


def relevance_and_pairwise(X, y):
    candidates = Candidates(X, y)
    return candidates.relevance, candidates.pairwise


def test_features_of_many_bins_are_no_longer_passed_over_for_uninformative_ones(unrelated):
    X, y = unrelated
    published = rank_ideal_point(*relevance_and_pairwise(X, y), 10).order
    corrected = rank_ideal_point_corrected(Candidates(X, y), 10).order
    assert np.count_nonzero(published >= 10) >= 4
    assert np.count_nonzero(corrected >= 10) <= 2


@pytest.mark.parametrize("correction", CORRECTIONS)
def test_relevance_and_redundancy_are_the_corrected_ones(rng, correction):
    X = rng.normal(size=(300, 3)) @ rng.normal(size=(3, 6)) + rng.normal(size=(300, 6))
    y = X[:, 0] + X[:, 3]
    ranking = rank_ideal_point_corrected(Candidates(X, y), 6, correction)
    relevance = np.maximum(corrected_mutual_information(X, y, correction=correction), 0)
    pairwise = corrected_mutual_information(X, X, correction=correction)
    pairwise = np.maximum(pairwise, 0)
    np.testing.assert_allclose(ranking.candidate_relevance, relevance)
    in_order = pairwise[np.ix_(ranking.order, ranking.order)]
    np.testing.assert_allclose(ranking.redundancy, np.tril(in_order, -1).sum(axis=1))


def test_all_the_redundancy_of_unrelated_features_is_bias():
    rng = np.random.default_rng(2)
    X = rng.uniform(size=(1000, 20))
    ranking = rank_ideal_point(*relevance_and_pairwise(X, X.sum(axis=1)), 20)
    for correction in CORRECTIONS:
        bias = redundancy_bias(X, ranking, correction=correction)
        assert bias[0] == 0
        assert (np.diff(bias) > 0.05).all()
        assert bias[-1] / ranking.redundancy[-1] == pytest.approx(1, abs=0.1)


def test_little_of_the_redundancy_of_copies_is_bias():
    x = np.random.default_rng(3).uniform(size=(1000, 1))
    X = x + 1e-3 * np.arange(3)
    ranking = rank_ideal_point(*relevance_and_pairwise(X, x[:, 0]), 3)
    assert (np.abs(redundancy_bias(X, ranking)) < 0.01 * ranking.redundancy + 1e-12).all()


@given(st.integers(0, 50))
def test_what_is_corrected_is_never_negative(seed):
    rng = np.random.default_rng(seed)
    X, y = rng.uniform(size=(100, 5)), rng.uniform(size=100)
    ranking = rank_ideal_point_corrected(Candidates(X, y), 5, "permutation")
    assert (ranking.candidate_relevance >= 0).all()
    assert (ranking.redundancy >= 0).all()


@pytest.fixture
def data(rng):
    X = rng.normal(size=(400, 3)) @ rng.normal(size=(3, 12)) + 0.5 * rng.normal(size=(400, 12))
    return X, np.column_stack([X[:, 0] + X[:, 1], rng.normal(size=400)])


def test_the_reference_agrees_with_itself(data):
    for stability in order_stability(*data, n_bins=[10], n_top=5):
        assert stability.same_steps.tolist() == [12]
        assert stability.overlap.tolist() == [1.0]
        assert stability.kendall_tau == pytest.approx([1.0])


def test_orders_are_compared_step_by_step_and_as_sets_and_as_ranks(data):
    X, Y = data
    bins = [5, 7, 16, 20]
    for target, stability in enumerate(order_stability(X, Y, bins, n_top=5)):
        orders = {}
        for n in (10, *bins):
            relevance = mutual_information(X, Y[:, target], n)
            orders[n] = rank_ideal_point(relevance, pairwise_mutual_information(X, n), 12).order
        expected = list(orders[10])
        for i, n in enumerate(bins):
            order = list(orders[n])
            assert stability.orders[i].tolist() == order
            same = [k for k in range(13) if order[:k] == expected[:k]]
            assert stability.same_steps[i] == max(same)
            assert stability.overlap[i] == len(set(order[:5]) & set(expected[:5])) / 5
            ranks = [[o.index(f) for f in range(12)] for o in (order, expected)]
            assert stability.kendall_tau[i] == pytest.approx(kendalltau(*ranks).statistic)


def test_noise_departs_and_clear_features_do_not(rng):
    y = rng.uniform(size=20_000)
    clear = np.column_stack([y + s * rng.normal(size=20_000) for s in (0.01, 0.1, 1.0)])
    (stability,) = order_stability(clear, y)
    assert stability.n_bins.tolist() == list(range(5, 21))
    assert (stability.same_steps == 3).all()
    (stability,) = order_stability(rng.uniform(size=(300, 30)), rng.uniform(size=300))
    assert stability.same_steps[stability.n_bins != 10].min() < 3


def test_a_single_target_gives_one_comparison(data):
    X, Y = data
    (stability,) = order_stability(X, Y[:, 0], n_bins=[5, 10])
    assert stability.orders.shape == (2, 12)


def test_a_single_feature_has_one_order(rng):
    x = rng.normal(size=(50, 1))
    (stability,) = order_stability(x, x[:, 0], n_bins=[5, 10])
    assert stability.same_steps.tolist() == [1, 1]
    assert stability.kendall_tau.tolist() == [1.0, 1.0]


def test_no_number_of_bins_is_refused(data):
    with pytest.raises(InvalidInputError, match="at least one number of bins"):
        order_stability(*data, n_bins=[])


relevances = st.lists(st.floats(0, 2), min_size=1, max_size=20)
thresholds = st.lists(st.floats(0, 1), max_size=20, unique=True)


@given(relevances, thresholds)
def test_each_threshold_is_found_once_with_just_the_features_above_it(relevance, thresholds):
    order = np.random.default_rng(0).permutation(len(relevance))
    subsets = threshold_subsets(order, relevance, thresholds)
    subset_at = {t: subset.features for subset in subsets for t in subset.thresholds}
    assert sum(len(subset.thresholds) for subset in subsets) == len(subset_at)
    for threshold in thresholds:
        above = [i for i, r in zip(order, relevance, strict=True) if r > threshold]
        assert list(subset_at.get(threshold, ())) == above


@given(relevances, thresholds)
def test_subsets_are_distinct_nested_and_not_empty(relevance, thresholds):
    subsets = threshold_subsets(range(len(relevance)), relevance, thresholds)
    assert all(subset.features for subset in subsets)
    for larger, smaller in pairwise(subsets):
        assert set(smaller.features) < set(larger.features)


def test_default_thresholds_go_from_0_to_1_bit():
    (subset,) = threshold_subsets([3, 1], [1.5, 1.2])
    assert subset.thresholds[0] == 0.0
    assert subset.thresholds[-1] == 1.0


def test_a_feature_exactly_at_the_threshold_is_left_out():
    assert threshold_subsets([0, 1], [0.5, 0.6], [0.5]) == [ThresholdSubset((1,), (0.5,))]


def test_the_subset_with_the_least_error_is_best():
    subsets = threshold_subsets([0, 1, 2], [0.9, 0.6, 0.3], [0.0, 0.5, 0.8])
    assert best_subset(subsets, [0.2, 0.1, 0.3]) == 1


def test_of_equal_errors_the_fewest_features_are_best():
    subsets = threshold_subsets([0, 1, 2], [0.9, 0.6, 0.3], [0.0, 0.5, 0.8])
    assert best_subset(subsets, [0.1, 0.1, 0.2]) == 1
    assert best_subset(subsets[::-1], [0.2, 0.1, 0.1]) == 1


def test_a_net_that_failed_is_never_best():
    subsets = threshold_subsets([0, 1], [0.9, 0.6], [0.0, 0.8])
    assert best_subset(subsets, [np.nan, 0.7]) == 1


@pytest.mark.parametrize(
    ("order", "relevance", "thresholds", "message"),
    [
        ([0, 1], [0.5], [0.0], "one entry for each ranked feature"),
        ([0], [np.nan], [0.0], "must be finite"),
        ([0], [0.5], [np.inf], "must be finite"),
    ],
)
def test_bad_thresholds_are_refused(order, relevance, thresholds, message):
    with pytest.raises(InvalidInputError, match=message):
        threshold_subsets(order, relevance, thresholds)


@pytest.mark.parametrize(
    ("rms", "message"), [([0.1, 0.2], "must be 1 errors"), ([np.nan], "all of it is NaN")]
)
def test_errors_that_do_not_fit_the_subsets_are_refused(rms, message):
    with pytest.raises(InvalidInputError, match=message):
        best_subset(threshold_subsets([0], [0.5], [0.0]), rms)
