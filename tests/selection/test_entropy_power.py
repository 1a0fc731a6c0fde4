import numpy as np
import pytest

from servoscope.selection.entropy_power import entropy_power, joint_information


def linear_gaussian(n, weights, noise, seed=0):
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(n, len(weights)))
    return X, X @ weights + rng.normal(0, noise, n)


def test_for_linear_gaussian_data_the_joint_figure_is_the_noise():
    X, y = linear_gaussian(4000, [1.0, -2.0, 0.5], 0.7)
    assert entropy_power(X, y).joint[0] == pytest.approx(0.7, rel=0.05)


def test_for_one_linear_gaussian_feature_both_figures_are_the_noise():
    X, y = linear_gaussian(4000, [1.0], 1.0)
    limits = entropy_power(X, y)
    assert limits.single[0] == pytest.approx(1.0, rel=0.06)
    assert limits.joint[0] == pytest.approx(1.0, rel=0.05)


def test_for_several_features_the_best_single_one_is_pessimistic():
    X, y = linear_gaussian(4000, [1.0] * 9, 0.5)
    alone = np.sqrt(8 + 0.25)
    assert entropy_power(X, y).single[0] == pytest.approx(alone, rel=0.06)


def test_joint_information_is_the_closed_form_of_the_multiple_correlation():
    X, y = linear_gaussian(20000, [3.0, 4.0], 1.0)
    assert joint_information(X, y[:, None])[0] == pytest.approx(0.5 * np.log2(26), abs=0.03)


def test_useless_features_do_not_add_information():
    rng = np.random.default_rng(0)
    values = [joint_information(rng.normal(size=(300, 60)), rng.normal(size=(300, 1)))[0]]
    values += [joint_information(rng.normal(size=(300, 60)), rng.normal(size=(300, 1)))[0]]
    assert np.mean(values) < 0.05


def test_a_feature_twice_counts_once():
    X, y = linear_gaussian(500, [1.0, 1.0], 1.0)
    once, twice = joint_information(X, y[:, None]), joint_information(X[:, [0, 1, 1]], y[:, None])
    assert twice == pytest.approx(once, abs=1e-9)


def test_what_tells_nothing_leaves_the_spread():
    rng = np.random.default_rng(0)
    limits = entropy_power(np.ones((2000, 2)), rng.normal(0, 4, 2000))
    assert limits.single[0] == pytest.approx(4.0, rel=0.05)
    assert limits.joint[0] == pytest.approx(4.0, rel=0.05)


def test_targets_that_never_change_and_few_samples_give_numbers():
    rng = np.random.default_rng(0)
    limits = entropy_power(
        rng.normal(size=(9, 30)), np.column_stack([np.full(9, 0.1), np.arange(9.0)])
    )
    assert limits.single[0] == limits.joint[0] == 0
    assert np.isfinite([*limits.single, *limits.joint]).all()
