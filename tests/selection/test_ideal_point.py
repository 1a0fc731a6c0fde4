import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from servoscope.errors import InvalidInputError
from servoscope.selection.ideal_point import rank_ideal_point
from servoscope.selection.mutual_information import mutual_information, pairwise_mutual_information


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
