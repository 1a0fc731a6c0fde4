import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from servoscope.selection.bias import CORRECTIONS, corrected_mutual_information
from servoscope.selection.candidates import Candidates
from servoscope.selection.ideal_point import rank_ideal_point
from servoscope.selection.ideal_point_corrected import rank_ideal_point_corrected, redundancy_bias


@pytest.fixture
def unrelated():
    """Ten features that tell the target a part each, and twelve bits that tell nothing."""
    rng = np.random.default_rng(1)
    X = np.column_stack([rng.uniform(size=(600, 10)), rng.integers(0, 2, (600, 12))])
    return X, X[:, :10].sum(axis=1)


@pytest.mark.parametrize("correction", CORRECTIONS)
def test_unrelated_features_have_hardly_any_redundancy(unrelated, correction):
    X, y = unrelated
    published = rank_ideal_point(*information(X, y), 10)
    corrected = rank_ideal_point_corrected(Candidates(X, y), 10, correction)
    assert corrected.redundancy[-1] < 0.2 * published.redundancy[-1] + 0.05


def information(X, y):
    candidates = Candidates(X, y)
    return candidates.relevance, candidates.pairwise


def test_features_of_many_bins_are_no_longer_passed_over_for_what_tells_nothing(unrelated):
    X, y = unrelated
    published = rank_ideal_point(*information(X, y), 10).order
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
    ranking = rank_ideal_point(*information(X, X.sum(axis=1)), 20)
    for correction in CORRECTIONS:
        bias = redundancy_bias(X, ranking, correction=correction)
        assert bias[0] == 0
        assert (np.diff(bias) > 0.05).all()
        assert bias[-1] / ranking.redundancy[-1] == pytest.approx(1, abs=0.1)


def test_little_of_the_redundancy_of_copies_is_bias():
    x = np.random.default_rng(3).uniform(size=(1000, 1))
    X = x + 1e-3 * np.arange(3)
    ranking = rank_ideal_point(*information(X, x[:, 0]), 3)
    assert (np.abs(redundancy_bias(X, ranking)) < 0.01 * ranking.redundancy + 1e-12).all()


@given(st.integers(0, 50))
def test_what_is_corrected_is_never_negative(seed):
    rng = np.random.default_rng(seed)
    X, y = rng.uniform(size=(100, 5)), rng.uniform(size=100)
    ranking = rank_ideal_point_corrected(Candidates(X, y), 5, "chi_square")
    assert (ranking.candidate_relevance >= 0).all()
    assert (ranking.redundancy >= 0).all()
