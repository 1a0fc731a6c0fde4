import numpy as np
import pandas as pd
import pytest
from scipy.optimize import approx_fprime, least_squares
from sklearn.utils.estimator_checks import parametrize_with_checks

from servoscope.errors import InvalidInputError
from servoscope.regression import LBFGSRegressor
from servoscope.regression.tanh_network import Objective, append_ones, evaluate, initial_weights
from servoscope.regression.training import LBFGSSettings, lbfgs


@parametrize_with_checks([LBFGSRegressor(hidden=5, restarts=1, max_iter=100)])
def test_is_a_scikit_learn_regressor(estimator, check):
    # check_array_api_input skips itself: arrays are NumPy's alone.
    check(estimator)


def _samples(n=80, k=2, noise=0.1, seed=0):
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(n, k))
    return X, np.tanh(X[:, 0]) * X[:, -1] + noise * rng.normal(size=n)


def _start(k, hidden, seed=0):
    return initial_weights(k, hidden, np.random.default_rng(seed))


def _cost(weights, X, y, weight_decay):
    return np.sum((y - evaluate(weights, append_ones(X))) ** 2) + weight_decay * weights @ weights


def _rms(weights, X, y):
    return np.sqrt(np.mean((y - evaluate(weights, append_ones(X))) ** 2))


def test_gradient_equals_forward_differences():
    X, y = _samples()
    objective, weights = Objective(X, y, X, y, 0.3), _start(2, 4)
    expected = approx_fprime(weights, _cost, 1e-7, X, y, 0.3)
    np.testing.assert_allclose(objective.gradient(objective.at(weights)), expected, rtol=1e-4)


def test_gradient_vanishes_at_convergence():
    X, y = _samples()
    start = _start(2, 4)
    result = lbfgs(X, y, start, settings=LBFGSSettings(max_iter=5000, tol=1e-15))
    assert result.status == "converged"
    at_start = approx_fprime(start, _cost, 1e-7, X, y, 0.1)
    at_end = approx_fprime(result.weights, _cost, 1e-7, X, y, 0.1)
    assert np.linalg.norm(at_end) < 1e-4 * np.linalg.norm(at_start)


def test_least_squares_finds_nothing_better_nearby():
    X, y = _samples()
    inputs = append_ones(X)

    def residuals(weights):
        return np.concatenate([y - evaluate(weights, inputs), np.sqrt(0.1) * weights])

    found = lbfgs(X, y, _start(2, 2), settings=LBFGSSettings(max_iter=5000, tol=1e-15))
    polished = least_squares(residuals, found.weights, xtol=1e-12, ftol=1e-12, gtol=1e-12)
    assert _cost(found.weights, X, y, 0.1) == pytest.approx(2 * polished.cost, rel=1e-6)


def test_early_stopping_returns_the_weights_of_the_least_validation_error():
    X, y = _samples(n=40, k=5, noise=0.5)
    X_val, y_val = _samples(n=60, k=5, noise=0.5, seed=1)
    settings = LBFGSSettings(weight_decay=0.0, min_improvement=0.0, patience=8)
    result = lbfgs(X, y, _start(5, 20), X_val, y_val, settings)
    assert result.status == "stopped_early"
    assert result.n_iter == result.best_iteration + 8
    assert result.best_iteration == np.argmin(result.validation_rms) > 0
    assert _rms(result.weights, X_val, y_val) == pytest.approx(result.best_rms, rel=1e-12)
    assert _rms(result.weights, X, y) == pytest.approx(
        result.training_rms[result.best_iteration], rel=1e-12
    )


def test_history_holds_the_start_and_every_step():
    X, y = _samples()
    start = _start(2, 6)
    result = lbfgs(X, y, start, X, y, LBFGSSettings(max_iter=7, tol=0.0))
    assert result.status == "max_iter"
    assert result.n_iter == 7
    assert len(result.training_rms) == len(result.validation_rms) == 8
    assert result.training_rms[0] == pytest.approx(_rms(start, X, y), rel=1e-12)
    np.testing.assert_allclose(result.training_rms, result.validation_rms, rtol=1e-12)


def test_without_validation_the_last_weights_are_kept():
    X, y = _samples()
    result = lbfgs(X, y, _start(2, 3), settings=LBFGSSettings(max_iter=30))
    assert np.isnan(result.validation_rms).all()
    assert result.best_iteration == result.n_iter
    assert _rms(result.weights, X, y) == pytest.approx(result.best_rms, rel=1e-12)


def _product(n=400, seed=0, noise=0.0):
    rng = np.random.default_rng(seed)
    X = rng.uniform(-2, 2, (n, 2))
    return X, np.sin(X[:, 0]) * X[:, 1] + noise * rng.normal(size=n)


def _fit(X, y, **parameters):
    return LBFGSRegressor(**parameters).fit(X[:300], y[:300], X[300:], y[300:])


def test_learns_a_product():
    X, y = _product()
    X_new, y_new = _product(seed=1)
    assert np.std(_fit(X, y).predict(X_new) - y_new) < 0.03


def test_keeps_the_start_of_least_validation_error_and_knows_it():
    X, y = _product(noise=0.3)
    net = _fit(X, y, restarts=4)
    errors = [result.best_rms for result in net.results_]
    assert len(set(errors)) == 4
    assert net.result_.best_rms == min(errors)
    mean, deviation = net.predict(X[300:], return_std=True)
    rms = np.sqrt(np.mean((mean - y[300:]) ** 2))
    np.testing.assert_allclose(deviation, rms, rtol=1e-10)


def test_the_same_seed_gives_the_same_weights_and_another_seed_others():
    X, y = _product()
    first, again, other = (_fit(X, y, random_state=seed, max_iter=50) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.network_.weights, again.network_.weights)
    assert not np.array_equal(first.network_.weights, other.network_.weights)


def test_constant_columns_and_a_constant_target_are_harmless():
    X, y = _product(n=400, noise=0.1)
    with_constant = np.column_stack([X, np.full(400, 0.1)])
    elsewhere = np.column_stack([X, np.full(400, 55.0)])
    net = _fit(with_constant, y)
    np.testing.assert_array_equal(net.predict(with_constant), net.predict(elsewhere))
    np.testing.assert_allclose(_fit(X, np.full(400, 0.1)).predict(X), 0.1, rtol=1e-15)


def test_arrays_bring_back_the_same_predictions_bit_for_bit(tmp_path):
    X, y = _product(noise=0.1)
    frame = pd.DataFrame(X, columns=["x_50", "theta_50"])
    net = _fit(frame, y, max_iter=50)
    np.savez(tmp_path / "net.npz", **net.to_arrays())
    with np.load(tmp_path / "net.npz", allow_pickle=False) as arrays:
        copy = LBFGSRegressor.from_arrays(arrays)
    for ours, theirs in zip(
        copy.predict(frame, return_std=True), net.predict(frame, return_std=True), strict=True
    ):
        np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"hidden": 0}, "hidden must be at least 1, got 0"),
        ({"patience": 0}, "patience must be at least 1"),
        ({"weight_decay": -1.0}, "weight_decay must not be negative"),
    ],
)
def test_parameters_out_of_range_are_refused(parameters, message):
    with pytest.raises(InvalidInputError, match=message):
        LBFGSRegressor(**parameters).fit(*_product(n=20))
