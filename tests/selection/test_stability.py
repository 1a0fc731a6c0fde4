import numpy as np
import pytest
from scipy.stats import kendalltau

from servoscope.errors import InvalidInputError
from servoscope.selection.ideal_point import rank_ideal_point
from servoscope.selection.mutual_information import mutual_information, pairwise_mutual_information
from servoscope.selection.stability import order_stability


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
