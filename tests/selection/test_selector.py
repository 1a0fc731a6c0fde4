from functools import partial

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.linear_model import LinearRegression
from sklearn.pipeline import make_pipeline
from sklearn.utils.estimator_checks import parametrize_with_checks

from servoscope.errors import InvalidInputError
from servoscope.selection.candidates import Candidates
from servoscope.selection.criteria import CRITERIA
from servoscope.selection.ideal_point import rank_ideal_point
from servoscope.selection.ideal_point_corrected import rank_ideal_point_corrected
from servoscope.selection.mutual_information import mutual_information, pairwise_mutual_information
from servoscope.selection.selector import MutualInfoSelector


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
    criterion = partial(rank_ideal_point_corrected, correction="chi_square")
    selector = clone(MutualInfoSelector(n_features=4, criterion=criterion)).fit(X, y)
    expected = rank_ideal_point_corrected(Candidates(X, y), 4, "chi_square")
    np.testing.assert_array_equal(selector.ranking_, expected.order)
    np.testing.assert_array_equal(selector.redundancy_, expected.redundancy)


@pytest.mark.parametrize("criterion", CRITERIA)
def test_every_criterion_selects_by_its_name(data, criterion):
    X, y = data
    selector = MutualInfoSelector(n_features=3, criterion=criterion).fit(X, y)
    assert selector.ranking_.tolist() == CRITERIA[criterion](Candidates(X, y), 3).order.tolist()
