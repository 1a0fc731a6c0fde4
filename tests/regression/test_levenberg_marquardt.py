from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import approx_fprime, least_squares

from servoscope.regression.levenberg_marquardt import (
    DualEquations,
    LMSettings,
    PrimalEquations,
    levenberg_marquardt,
)
from servoscope.regression.tanh_network import append_ones, evaluate, initial_weights

TO_CONVERGENCE = LMSettings(max_iter=1000, damping=1.0, tol=1e-13)


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


@pytest.mark.parametrize("weight_decay", [0.01, 1.0])
@pytest.mark.parametrize("form", ["dual", "primal"])
def test_gradient_vanishes_at_convergence(form, weight_decay):
    X, y = _samples()
    inputs = append_ones(X)
    equations = DualEquations(inputs) if form == "dual" else PrimalEquations(inputs, 4)
    options = LMSettings(max_iter=1000, damping=1.0, tol=1e-13, weight_decay=weight_decay)
    start = _start(2, 4)
    result = levenberg_marquardt(X, y, start, settings=options, equations=equations)
    assert result.status in {"converged", "damping_limit"}
    at_start = approx_fprime(start, _cost, 1e-7, X, y, weight_decay)
    at_end = approx_fprime(result.weights, _cost, 1e-7, X, y, weight_decay)
    assert np.linalg.norm(at_end) < 1e-4 * np.linalg.norm(at_start)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_scipy_finds_the_same_least_squares(seed):
    X, y = _samples(seed=seed)
    inputs, start, weight_decay = append_ones(X), _start(2, 2, seed), 0.1

    def residuals(weights):
        penalty = np.sqrt(weight_decay) * weights
        return np.concatenate([y - evaluate(weights, inputs), penalty])

    options = LMSettings(max_iter=1000, damping=1.0, tol=1e-13, weight_decay=weight_decay)
    result = levenberg_marquardt(X, y, start, settings=options)
    polished = least_squares(residuals, result.weights, xtol=1e-12, ftol=1e-12, gtol=1e-12)
    np.testing.assert_allclose(
        _cost(result.weights, X, y, weight_decay), 2 * polished.cost, rtol=1e-7
    )
    from_start = least_squares(residuals, start, xtol=1e-12, ftol=1e-12, gtol=1e-12)
    assert _cost(result.weights, X, y, weight_decay) < 2 * from_start.cost * (1 + 1e-6)


def test_recovers_a_network_of_the_same_shape():
    X, _ = _samples(n=200)
    y = evaluate(_start(2, 2, seed=7) * 3, append_ones(X))
    runs = [levenberg_marquardt(X, y, _start(2, 3, s), settings=TO_CONVERGENCE) for s in range(5)]
    assert min(run.best_rms for run in runs) < 1e-4


@settings(deadline=None, max_examples=25)
@given(
    n=st.integers(2, 60),
    k=st.integers(1, 5),
    hidden=st.integers(1, 8),
    weight_decay=st.sampled_from([0.0, 0.3]),
    seed=st.integers(0, 50),
)
def test_every_step_lowers_the_cost(n, k, hidden, weight_decay, seed):
    X, y = _samples(n, k, seed=seed)
    weights = _start(k, hidden, seed)
    costs = [_cost(weights, X, y, weight_decay)]
    for max_iter in (1, 2, 3):
        options = LMSettings(max_iter=max_iter, weight_decay=weight_decay)
        result = levenberg_marquardt(X, y, weights, settings=options)
        costs.append(_cost(result.weights, X, y, weight_decay))
    assert all(after < before for before, after in pairwise(costs)) or (result.n_iter < 3)


def test_early_stopping_returns_the_weights_of_the_least_validation_error():
    X, y = _samples(n=40, k=5, noise=0.5)
    X_val, y_val = _samples(n=60, k=5, noise=0.5, seed=1)
    result = levenberg_marquardt(X, y, _start(5, 20), X_val, y_val)
    assert result.status == "stopped_early"
    assert 0 < result.best_iteration < result.n_iter
    assert result.best_iteration == np.argmin(result.validation_rms)
    assert _rms(result.weights, X_val, y_val) == pytest.approx(result.best_rms, rel=1e-12)
    assert _rms(result.weights, X, y) == pytest.approx(
        result.training_rms[result.best_iteration], rel=1e-12
    )


def test_stops_when_patience_is_over():
    X, y = _samples(n=40, k=5, noise=0.5)
    X_val, y_val = _samples(n=60, k=5, noise=0.5, seed=1)
    for patience in (1, 3, 6):
        options = LMSettings(patience=patience, min_improvement=0.0)
        result = levenberg_marquardt(X, y, _start(5, 20), X_val, y_val, options)
        assert result.n_iter == result.best_iteration + patience


def test_history_holds_the_start_and_every_step():
    X, y = _samples()
    start = _start(2, 6)
    result = levenberg_marquardt(X, y, start, X, y, LMSettings(max_iter=7, tol=0.0))
    assert result.status == "max_iter"
    assert result.n_iter == 7
    assert len(result.training_rms) == len(result.validation_rms) == len(result.damping) == 8
    assert result.training_rms[0] == pytest.approx(_rms(start, X, y), rel=1e-12)
    assert (np.diff(result.training_rms) < 0).all()
    np.testing.assert_allclose(result.training_rms, result.validation_rms, rtol=1e-12)


def test_without_validation_its_error_is_nan_and_the_last_weights_are_kept():
    X, y = _samples()
    result = levenberg_marquardt(X, y, _start(2, 3), settings=LMSettings(max_iter=30))
    assert np.isnan(result.validation_rms).all()
    assert result.best_iteration == result.n_iter
    assert result.best_rms == result.training_rms[-1]
    assert _rms(result.weights, X, y) == pytest.approx(result.best_rms, rel=1e-12)


def test_a_start_that_is_optimal_ends_at_once():
    X, _ = _samples()
    weights = _start(2, 3)
    y = evaluate(weights, append_ones(X))
    result = levenberg_marquardt(X, y, weights)
    assert result.status in {"damping_limit", "converged"}
    np.testing.assert_allclose(result.weights, weights, atol=1e-12)
