import numpy as np
import pytest

from servoscope.errors import InvalidInputError
from servoscope.selection import MutualInfoSelector
from servoscope.selection.forward import forward_selection


def samples(n=300, noise=0.05, seed=0):
    """Of 12 candidates, 5 informs most, 2 less, and 7 is 5 with noise."""
    rng = np.random.default_rng(seed)
    X = rng.uniform(-1, 1, (n, 12))
    X[:, 7] = X[:, 5] + rng.normal(0, 0.1, n)
    return X, np.sin(2 * X[:, 5]) + 0.5 * X[:, 2] ** 2 + rng.normal(0, noise, n)


def test_features_are_selected_by_what_they_add():
    X, y = samples()
    assert forward_selection(X, y, 3).order[:2].tolist() == [5, 2]


def test_features_that_inform_only_as_a_product_are_found_once_one_of_them_is_in():
    X = np.random.default_rng(0).uniform(-1, 1, (300, 6))
    order = forward_selection(X, 0.3 * X[:, 1] + X[:, 1] * X[:, 4], 2).order
    assert order.tolist() == [1, 4]


def test_the_error_along_the_way_ends_at_the_noise():
    X, y = samples(400, noise=0.2)
    errors = forward_selection(X, y, 4).errors
    assert errors[1] == pytest.approx(0.2, rel=0.15)
    assert errors[0] > 1.1 * errors[1]


def test_the_error_of_uninformative_features_is_the_spread_and_not_less():
    """The least of many chance errors would be below it."""
    rng = np.random.default_rng(0)
    X, y = rng.normal(size=(1000, 30)), rng.normal(size=1000)
    errors = forward_selection(X, y, 8, max_samples=80).errors
    assert (errors > 0.98 * y.std()).all()


def test_relevance_is_the_information_of_linear_gaussian_features():
    rng = np.random.default_rng(0)
    X = rng.normal(size=(1000, 3))
    ranking = forward_selection(X, X[:, 0] + rng.normal(size=1000), 1, max_samples=300)
    assert ranking.candidate_relevance[0] == pytest.approx(0.5, abs=0.1)
    assert (ranking.candidate_relevance[1:] < 0.04).all()


def test_a_copy_is_redundant_by_its_relevance():
    X, y = samples()
    ranking = forward_selection(X, y, 2)
    assert ranking.order[0] == 5
    assert ranking.candidate_redundancy[1, 7] == pytest.approx(
        ranking.candidate_relevance[7], rel=0.15
    )
    assert np.isnan(ranking.candidate_redundancy[1, 5])
    assert (ranking.candidate_redundancy[0] == 0).all()


def test_each_step_selects_the_greatest_relevance_less_redundancy():
    ranking = forward_selection(*samples(120), 4)
    gains = ranking.candidate_relevance - ranking.candidate_redundancy
    np.testing.assert_array_equal(np.nanargmax(gains[1:], axis=1), ranking.order[1:])


def test_all_features_are_ranked_where_more_are_asked_for():
    X, y = samples(60)
    assert sorted(forward_selection(X, y, 99).order) == list(range(12))


def test_groups_are_left_out_together():
    walks = np.cumsum(np.random.default_rng(0).normal(size=(200, 4)), axis=0)
    X, y = walks[:, :3], walks[:, 3]
    together = forward_selection(X, y, 3, groups=np.arange(200) // 10)
    assert together.errors[-1] > 1.5 * forward_selection(X, y, 3).errors[-1]


def test_the_selector_knows_it_by_name():
    X, y = samples(100)
    selector = MutualInfoSelector(3, criterion="forecast").fit(X, y)
    np.testing.assert_array_equal(selector.ranking_, forward_selection(X, y, 3).order)


@pytest.mark.parametrize(
    ("X", "y"),
    [
        (np.random.default_rng(0).normal(size=(20, 5)), np.full(20, 0.3)),
        (np.ones((20, 5)), np.arange(20.0)),
        (np.ones((20, 5)) * np.arange(20.0)[:, None], np.arange(20.0)),
        (np.repeat(np.random.default_rng(0).normal(size=(10, 5)), 2, axis=0), np.arange(20.0)),
    ],
    ids=["constant target", "constant features", "equal features", "images taken twice"],
)
def test_degenerate_samples_have_a_ranking(X, y):
    ranking = forward_selection(X, y, 3)
    assert len(set(ranking.order.tolist())) == 3
    assert np.isfinite(ranking.errors).all()
    assert np.isfinite(ranking.relevance).all()
    assert np.isfinite(ranking.redundancy).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"n_features": 0}, "n_features must be 1 or more"),
        ({"y": np.zeros(7), "X": np.zeros((7, 2))}, "at least 8 samples"),
        ({"X": np.full((20, 2), np.nan)}, "X must be finite"),
    ],
)
def test_bad_input_is_named(change, message):
    rng = np.random.default_rng(0)
    arguments = {"X": rng.normal(size=(20, 2)), "y": rng.normal(size=20)} | change
    with pytest.raises(InvalidInputError, match=message):
        forward_selection(**arguments)
