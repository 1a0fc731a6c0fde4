from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.base import clone
from sklearn.linear_model import LinearRegression
from sklearn.pipeline import make_pipeline
from sklearn.utils.estimator_checks import parametrize_with_checks

from servoscope.errors import InvalidInputError
from servoscope.selection.candidates import Candidates
from servoscope.selection.criteria import CRITERIA, MutualInfoSelector
from servoscope.selection.estimators import (
    mutual_information,
    pairwise_mutual_information,
)
from servoscope.selection.histograms import bin_codes
from servoscope.selection.ideal_point import rank_ideal_point, rank_ideal_point_corrected

OF_INFORMATION = [name for name in CRITERIA if name != "forecast"]
SEES_PAIRS = ("jmi",)


def entropy(*codes):
    counts = np.unique(np.stack(codes), axis=1, return_counts=True)[1]
    p = counts / counts.sum()
    return -np.sum(p * np.log2(p))


def information(a, b):
    return entropy(a) + entropy(b) - entropy(a, b)


def conditional(a, b, c):
    return entropy(a, c) + entropy(b, c) - entropy(a, b, c) - entropy(c)


# The definitions of Brown et al. (2012), for the codes f of a candidate, y of the target, and s of
# the features that are selected.
DEFINITIONS = {
    "jmi": lambda f, y, s: (
        information(f, y)
        - np.mean([information(k, f) for k in s])
        + np.mean([conditional(k, f, y) for k in s])
    ),
}


def mixed(seed, n_samples=300, n_features=9):
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(n_samples, 4)) @ rng.normal(size=(4, n_features))
    X += 0.5 * rng.normal(size=X.shape)
    return X, X[:, 0] * X[:, 1] + X[:, 2] + 0.3 * rng.normal(size=n_samples)


@pytest.mark.parametrize("criterion", DEFINITIONS)
@pytest.mark.parametrize("n_bins", [4, 10])
def test_each_step_selects_the_greatest_by_the_definition(criterion, n_bins):
    X, y = mixed(1)
    codes, (target,) = bin_codes(X, n_bins), bin_codes(y[:, None], n_bins)
    order = CRITERIA[criterion](Candidates(X, y, n_bins), 9).order
    assert order[0] == np.argmax([information(f, target) for f in codes])
    for step in range(1, 9):
        selected = codes[order[:step]]
        scores = {
            i: DEFINITIONS[criterion](codes[i], target, selected)
            for i in range(9)
            if i not in order[:step]
        }
        assert scores[order[step]] >= max(scores.values()) - 1e-12


@pytest.mark.parametrize("criterion", OF_INFORMATION)
def test_every_candidate_is_ranked_once_with_the_redundancy_of_its_step(criterion):
    X, y = mixed(2)
    candidates = Candidates(X, y)
    ranking = CRITERIA[criterion](candidates, 24)
    assert sorted(ranking.order) == list(range(9))
    if criterion != "ideal_point_corrected":
        np.testing.assert_array_equal(ranking.candidate_relevance, mutual_information(X, y))
        expected = np.tril(pairwise_mutual_information(X[:, ranking.order]), -1).sum(axis=1)
        np.testing.assert_allclose(ranking.redundancy, expected, atol=1e-12)


@pytest.mark.parametrize("criterion", OF_INFORMATION)
def test_the_first_features_do_not_depend_on_how_many_are_asked_for(criterion):
    candidates = Candidates(*mixed(3))
    few, all_of_them = (CRITERIA[criterion](candidates, n).order.tolist() for n in (4, 9))
    assert few == all_of_them[:4]


@pytest.mark.parametrize("criterion", OF_INFORMATION)
@settings(max_examples=5)
@given(st.permutations(range(9)), st.integers(0, 5))
def test_the_order_of_the_columns_does_not_matter(criterion, columns, seed):
    X, y = mixed(seed)
    expected = CRITERIA[criterion](Candidates(X, y), 9).order
    found = CRITERIA[criterion](Candidates(X[:, columns], y), 9).order
    np.testing.assert_array_equal(np.array(columns)[found], expected)


@pytest.fixture
def exclusive_or():
    """Bits 3 and 6 give the target together; bit 3 alone a little, noise 0 to 2 a very little."""
    rng = np.random.default_rng(4)
    bits = rng.integers(0, 2, (4000, 8))
    y = bits[:, 3] ^ bits[:, 6]
    bits[:400, 3] = y[:400]
    for noise in range(3):
        bits[noise * 200 : noise * 200 + 200, noise] = y[noise * 200 : noise * 200 + 200]
    return bits, y


@pytest.mark.parametrize("criterion", SEES_PAIRS)
def test_joint_information_of_two_features_is_seen(criterion, exclusive_or):
    assert CRITERIA[criterion](Candidates(*exclusive_or, n_bins=2), 2).order.tolist() == [3, 6]


@pytest.mark.parametrize("criterion", ["ideal_point"])
def test_relevance_and_redundancy_do_not_see_it(criterion, exclusive_or):
    order = CRITERIA[criterion](Candidates(*exclusive_or, n_bins=2), 2).order
    assert order[0] == 3
    assert 6 not in order


@pytest.mark.parametrize("criterion", OF_INFORMATION)
def test_a_copy_comes_after_what_is_new(criterion):
    X = np.random.default_rng(5).uniform(size=(2000, 3))
    X[:, 1] = X[:, 0]
    order = CRITERIA[criterion](Candidates(X, X[:, 0] + 0.6 * X[:, 2]), 3).order
    assert order.tolist() == [0, 2, 1]


@pytest.mark.parametrize("criterion", OF_INFORMATION)
def test_constants_are_no_obstacle(criterion):
    X, y = mixed(6, n_features=3)
    X[:, 1] = 7.0
    assert len(CRITERIA[criterion](Candidates(X, y), 3).order) == 3
    assert len(CRITERIA[criterion](Candidates(X, np.zeros(300)), 3).order) == 3


@pytest.mark.parametrize("criterion", OF_INFORMATION)
@pytest.mark.parametrize("n_features", [0, -2])
def test_no_feature_at_all_is_refused(criterion, n_features):
    with pytest.raises(InvalidInputError, match=f"n_features must be .*got {n_features}"):
        CRITERIA[criterion](Candidates(*mixed(7)), n_features)


def test_candidates_that_do_not_fit_are_refused():
    with pytest.raises(InvalidInputError, match="as many samples, got 3 and 4"):
        Candidates(np.zeros((3, 1)), np.zeros(4))
    with pytest.raises(InvalidInputError, match="one target, got the shape \\(3, 2\\)"):
        Candidates(np.zeros((3, 1)), np.zeros((3, 2)))


# Nothing is skipped but what scikit-learn itself skips: the array API check, which needs the
# environment variable SCIPY_ARRAY_API.
@pytest.mark.filterwarnings("ignore::sklearn.exceptions.SkipTestWarning")
@parametrize_with_checks([MutualInfoSelector(), MutualInfoSelector(n_features=1)])
def test_scikit_learn_checks(estimator, check):
    check(estimator)


@pytest.fixture
def data(rng):
    X = rng.uniform(size=(800, 6))
    X[:, 4] = X[:, 1]
    return X, X @ [0.0, 1.0, 0.6, 0.0, 1.0, 0.3]


def test_attributes_are_those_of_the_ideal_point_ranking(data):
    X, y = data
    selector = MutualInfoSelector(n_features=4, n_bins=8).fit(X, y)
    relevance = mutual_information(X, y, 8)
    ranking = rank_ideal_point(relevance, pairwise_mutual_information(X, 8), 4)
    np.testing.assert_array_equal(selector.ranking_, ranking.order)
    np.testing.assert_array_equal(selector.relevance_, ranking.relevance)
    np.testing.assert_array_equal(selector.redundancy_, ranking.redundancy)
    np.testing.assert_array_equal(selector.mutual_information_, relevance)
    np.testing.assert_array_equal(selector.candidate_redundancy_, ranking.candidate_redundancy)


def test_transform_keeps_the_selected_columns_in_their_original_order(data):
    X, y = data
    selector = MutualInfoSelector(n_features=3).fit(X, y)
    assert selector.ranking_.tolist() == [1, 2, 5]
    np.testing.assert_array_equal(selector.transform(X), X[:, [1, 2, 5]])
    np.testing.assert_array_equal(selector.get_support(indices=True), [1, 2, 5])


def test_names_follow_the_columns_of_a_data_frame(data):
    pd = pytest.importorskip("pandas")
    X, y = data
    frame = pd.DataFrame(X, columns=["x_50", "theta_50", "e_00", "r1_50", "r2_50", "pci_rz"])
    selector = MutualInfoSelector(n_features=3).set_output(transform="pandas").fit(frame, y)
    assert selector.transform(frame).columns.tolist() == ["theta_50", "e_00", "pci_rz"]


def test_more_features_than_there_are_selects_all(data):
    X, y = data
    selector = MutualInfoSelector(n_features=24).fit(X, y)
    assert sorted(selector.ranking_) == list(range(6))
    assert selector.get_support().all()


def test_a_selector_works_in_a_pipeline(data):
    X, y = data
    model = clone(make_pipeline(MutualInfoSelector(n_features=3), LinearRegression())).fit(X, y)
    assert model.score(X, y) == pytest.approx(1.0)


def test_a_constant_feature_and_a_constant_target_are_no_obstacle(data):
    X, _ = data
    X[:, 0] = 3.0
    selector = MutualInfoSelector().fit(X, np.ones(len(X)))
    assert (selector.mutual_information_ == 0).all()
    assert selector.ranking_[0] == 0


@pytest.mark.parametrize("n_features", [0, -1, 2.5, "all", None])
def test_a_number_of_features_that_is_none_is_refused(data, n_features):
    with pytest.raises(InvalidInputError, match="n_features must be an integer of 1 or more"):
        MutualInfoSelector(n_features=n_features).fit(*data)


def test_an_unknown_criterion_is_refused_with_those_that_exist(data):
    with pytest.raises(InvalidInputError, match=r"one of ideal_point, .*, got 'mrr'"):
        MutualInfoSelector(criterion="mrr").fit(*data)


def test_a_number_of_bins_out_of_range_is_refused(data):
    with pytest.raises(InvalidInputError, match="n_bins must be an integer from 2 to 256, got 1"):
        MutualInfoSelector(n_bins=1).fit(*data)


def test_a_feature_that_is_not_finite_is_refused(data):
    X, y = data
    X[3, 2] = np.nan
    with pytest.raises(InvalidInputError, match=r"X must be finite .* column 2"):
        MutualInfoSelector().fit(X, y)


def test_a_criterion_may_be_a_function(data):
    X, y = data
    criterion = partial(rank_ideal_point_corrected, correction="permutation")
    selector = clone(MutualInfoSelector(n_features=4, criterion=criterion)).fit(X, y)
    expected = rank_ideal_point_corrected(Candidates(X, y), 4, "permutation")
    np.testing.assert_array_equal(selector.ranking_, expected.order)
    np.testing.assert_array_equal(selector.redundancy_, expected.redundancy)


@pytest.mark.parametrize("criterion", CRITERIA)
def test_every_criterion_selects_by_its_name(data, criterion):
    X, y = data
    selector = MutualInfoSelector(n_features=3, criterion=criterion).fit(X, y)
    assert selector.ranking_.tolist() == CRITERIA[criterion](Candidates(X, y), 3).order.tolist()
