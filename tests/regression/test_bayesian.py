import numpy as np
import pandas as pd
import pytest
from sklearn.linear_model import BayesianRidge
from sklearn.utils.estimator_checks import parametrize_with_checks

from servoscope.errors import InvalidInputError
from servoscope.regression import BayesianLMRegressor, LMRegressor
from servoscope.regression.bayesian import (
    BayesianSettings,
    Evidence,
    WeightPosterior,
    bayesian_lm,
    curvature,
)
from servoscope.regression.tanh_network import (
    Linearisation,
    activate,
    append_ones,
    evaluate,
    initial_weights,
    linearise,
)


@parametrize_with_checks([BayesianLMRegressor(hidden=5)])
def test_is_a_scikit_learn_regressor(estimator, check):
    # check_array_api_input skips itself: arrays are NumPy's alone.
    check(estimator)


def _product(n=200, seed=0, noise=0.1):
    rng = np.random.default_rng(seed)
    X = rng.uniform(-2, 2, (n, 2))
    return X, np.sin(X[:, 0]) * X[:, 1] + noise * rng.normal(size=n)


@pytest.mark.parametrize("n", [5, 60], ids=["more weights", "more samples"])
def test_curvature_is_the_spectrum_of_the_gauss_newton_matrix(n):
    rng = np.random.default_rng(0)
    inputs, weights = append_ones(rng.normal(size=(n, 3))), initial_weights(3, 4, rng)
    linearisation = linearise(weights, inputs, activate(weights, inputs))
    J = linearisation.jacobian()
    singular = np.sort(np.linalg.svd(J, compute_uv=False))
    np.testing.assert_allclose(curvature(linearisation), singular**2, rtol=1e-8, atol=1e-12)


def _linear_model(n=30, k=4):
    """Activations alone, with no hidden slopes: a linear model, where Laplace is exact."""
    rng = np.random.default_rng(0)
    A = rng.normal(size=(n, k))
    y = A @ rng.normal(size=k) + 0.3 * rng.normal(size=n)
    return A, y, Linearisation(np.zeros((n, 1)), np.zeros((n, k - 1)), A)


def _evidence_of_linear_model(A, y, linearisation, decay):
    weights = np.linalg.solve(A.T @ A + decay * np.eye(A.shape[1]), A.T @ y)
    cost = np.sum((y - A @ weights) ** 2) + decay * weights @ weights
    return Evidence(decay, cost, len(y), curvature(linearisation))


@pytest.mark.parametrize("decay", [0.01, 1.0, 50.0])
def test_evidence_of_a_linear_model_is_the_density_of_its_targets(decay):
    A, y, linearisation = _linear_model()
    evidence = _evidence_of_linear_model(A, y, linearisation, decay)
    covariance = evidence.noise**2 * (np.eye(30) + A @ A.T / decay)
    _, log_determinant = np.linalg.slogdet(covariance)
    expected = -0.5 * (y @ np.linalg.solve(covariance, y) + log_determinant)
    constant = -0.5 * len(y)
    assert evidence.log_evidence + constant == pytest.approx(expected, rel=1e-10)


def test_scikit_learn_finds_the_decay_of_the_largest_evidence():
    A, y, linearisation = _linear_model()
    decays = np.geomspace(1e-3, 1e2, 400)
    evidences = [_evidence_of_linear_model(A, y, linearisation, d).log_evidence for d in decays]
    flat = {"alpha_1": 0, "alpha_2": 0, "lambda_1": 0, "lambda_2": 0}
    other = BayesianRidge(fit_intercept=False, tol=1e-9, max_iter=1000, **flat).fit(A, y)
    assert decays[np.argmax(evidences)] == pytest.approx(other.lambda_ / other.alpha_, rel=0.05)


def test_effective_parameters_are_the_trace_of_the_smoother():
    A, y, linearisation = _linear_model()
    smoother = A @ np.linalg.solve(A.T @ A + 3.0 * np.eye(4), A.T)
    evidence = _evidence_of_linear_model(A, y, linearisation, 3.0)
    assert evidence.effective_parameters == pytest.approx(np.trace(smoother), rel=1e-10)


@pytest.mark.parametrize("n", [10, 80])
def test_deviation_equals_laplace_written_out_with_differences(n):
    rng = np.random.default_rng(0)
    X, X_new, weights = rng.normal(size=(n, 2)), rng.normal(size=(6, 2)), initial_weights(2, 3, rng)

    def jacobian(samples, step=1e-6):
        inputs = append_ones(samples)
        columns = [
            (evaluate(weights + step * e, inputs) - evaluate(weights - step * e, inputs))
            for e in np.eye(len(weights))
        ]
        return np.transpose(columns) / (2 * step)

    J, J_new = jacobian(X), jacobian(X_new)
    spread = np.linalg.inv(J.T @ J + 0.7 * np.eye(len(weights)))
    expected = 0.2 * np.sqrt(1 + np.diag(J_new @ spread @ J_new.T))
    found = WeightPosterior(weights, X, weight_decay=0.7, noise=0.2).deviation(X_new)
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_the_decay_falls_until_the_evidence_does():
    X, y = _product(80, noise=0.3)
    start = initial_weights(2, 10, np.random.default_rng(0))
    evidences = {
        n: bayesian_lm(X, y, start, settings=BayesianSettings(n_decays=n)).evidence
        for n in range(1, 25)
    }
    best = evidences[24]
    assert best.weight_decay < 10.0
    assert best.log_evidence == max(e.log_evidence for e in evidences.values())
    assert [e.log_evidence for e in evidences.values()] == sorted(
        e.log_evidence for e in evidences.values()
    )


def test_no_weaker_decay_is_tried_once_the_evidence_falls():
    X, y = _product(80, noise=0.3)
    start = initial_weights(2, 10, np.random.default_rng(0))
    hasty, patient = (
        bayesian_lm(X, y, start, settings=BayesianSettings(patience=n)) for n in (1, 24)
    )
    assert hasty.n_iter < patient.n_iter
    assert hasty.status == "converged"


def test_history_goes_on_from_decay_to_decay():
    X, y = _product(80)
    start = initial_weights(2, 10, np.random.default_rng(0))
    result = bayesian_lm(X, y, start)
    assert len(result.training_rms) == len(result.damping) == result.n_iter + 1
    rms = np.sqrt(np.mean((y - evaluate(result.weights, append_ones(X))) ** 2))
    assert result.best_rms == pytest.approx(rms, rel=1e-12)
    assert result.best_iteration < result.n_iter


def test_weak_features_are_not_fitted_to_noise():
    rng = np.random.default_rng(0)
    X, X_new = rng.normal(size=(150, 20)), rng.normal(size=(500, 20))
    y = X[:, 0] + rng.normal(size=150)
    free = LMRegressor(max_iter=60, restarts=1).fit(X, y).predict(X_new)
    bayesian = BayesianLMRegressor().fit(X, y).predict(X_new)
    assert np.std(bayesian - X_new[:, 0]) < 0.4 * np.std(free - X_new[:, 0])


@pytest.mark.parametrize("with_validation", [False, True])
def test_the_predicted_deviation_covers_new_targets(with_validation):
    X, y = _product(300, noise=0.2)
    X_new, y_new = _product(2000, seed=1, noise=0.2)
    parts = (X[:150], y[:150], X[150:], y[150:]) if with_validation else (X, y)
    mean, deviation = BayesianLMRegressor().fit(*parts).predict(X_new, return_std=True)
    assert 0.9 < np.mean(np.abs(y_new - mean) < 1.96 * deviation) < 0.985


def test_validation_samples_are_learned_from():
    X, y = _product(noise=0.0)
    half = X[:, 0] < 0
    alone = BayesianLMRegressor().fit(X[half], y[half]).predict(X[~half])
    both = BayesianLMRegressor().fit(X[half], y[half], X[~half], y[~half]).predict(X[~half])
    assert np.std(both - y[~half]) < 0.1 * np.std(alone - y[~half])


def test_validation_errors_set_the_noise_and_no_prediction():
    X, y = _product()
    X_val, y_val = _product(100, seed=1)
    alone = BayesianLMRegressor().fit(X, y)
    mean, expected = alone.predict(X_val, return_std=True)
    factor = np.sqrt(np.mean(((y_val - mean) / expected) ** 2))
    joined = BayesianLMRegressor().fit(np.vstack([X, X_val]), np.concatenate([y, y_val]))
    both = BayesianLMRegressor().fit(X, y, X_val, y_val)
    before, after = (net.posterior_.noise / net.network_.target.scale for net in (alone, both))
    assert after == pytest.approx(factor * before, rel=1e-10)
    np.testing.assert_array_equal(both.predict(X), joined.predict(X))


def test_doubt_grows_away_from_the_samples():
    X, y = _product()
    net = BayesianLMRegressor().fit(X, y)
    (_, near), (_, far) = (net.predict(samples, return_std=True) for samples in (X, X * 10))
    assert far.mean() > 5 * near.mean()


def test_deviation_is_in_the_unit_of_the_target():
    X, y = _product()
    _, one = BayesianLMRegressor().fit(X, y).predict(X, return_std=True)
    _, thousand = BayesianLMRegressor().fit(X, 1024 * y).predict(X, return_std=True)
    np.testing.assert_allclose(thousand, 1024 * one, rtol=1e-6)


@pytest.mark.parametrize("n", [2, 9])
@pytest.mark.parametrize("n_features", [1, 12])
@pytest.mark.parametrize("repeated", [1, 4])
def test_few_and_repeated_samples_give_finite_answers(n, n_features, repeated):
    rng = np.random.default_rng(0)
    X, y = rng.normal(size=(n, n_features)), rng.normal(size=n)
    net = BayesianLMRegressor().fit(np.tile(X, (repeated, 1)), np.tile(y, repeated))
    assert np.isfinite(net.predict(X, return_std=True)).all()


def test_constant_columns_and_a_constant_target_are_harmless():
    X, y = _product(n=100)
    with_constant = np.column_stack([X, np.full(100, 0.1)])
    elsewhere = np.column_stack([X, np.full(100, 55.0)])
    net = BayesianLMRegressor(hidden=5).fit(with_constant, y)
    np.testing.assert_array_equal(net.predict(with_constant), net.predict(elsewhere))
    mean, deviation = net.fit(X, np.full(100, 0.1)).predict(X, return_std=True)
    np.testing.assert_allclose(mean, 0.1, rtol=1e-15)
    assert 0 < deviation.min() <= deviation.max() < 1e-12


def test_the_same_seed_gives_the_same_weights_and_another_seed_others():
    X, y = _product(100)
    first, again, other = (
        BayesianLMRegressor(random_state=seed).fit(X, y).network_.weights for seed in (3, 3, 4)
    )
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


def test_the_start_of_the_largest_evidence_is_kept():
    X, y = _product(100)
    net = BayesianLMRegressor(restarts=3).fit(X, y)
    evidences = [result.evidence.log_evidence for result in net.results_]
    assert len(set(evidences)) == 3
    assert net.result_.evidence.log_evidence == max(evidences)


def test_arrays_bring_back_the_same_predictions_bit_for_bit(tmp_path):
    X, y = _product(100)
    frame = pd.DataFrame(X, columns=["x_50", "theta_50"])
    net = BayesianLMRegressor(hidden=5).fit(frame[:80], y[:80], frame[80:], y[80:])
    np.savez(tmp_path / "net.npz", **net.to_arrays())
    with np.load(tmp_path / "net.npz", allow_pickle=False) as arrays:
        copy = BayesianLMRegressor.from_arrays(arrays)
    for ours, theirs in zip(
        copy.predict(frame, return_std=True), net.predict(frame, return_std=True), strict=True
    ):
        np.testing.assert_array_equal(ours, theirs)


def test_arrays_that_do_not_fit_together_are_refused():
    X, y = _product(60)
    arrays = BayesianLMRegressor(hidden=3).fit(X, y).to_arrays()
    with pytest.raises(InvalidInputError, match="needs the array 'noise'"):
        BayesianLMRegressor.from_arrays({k: a for k, a in arrays.items() if k != "noise"})
    with pytest.raises(InvalidInputError, match=r"Samples of shape \(60, 1\)"):
        BayesianLMRegressor.from_arrays(arrays | {"samples": X[:, :1]})


def test_parameters_out_of_range_are_refused():
    with pytest.raises(InvalidInputError, match="hidden must be at least 1, got 0"):
        BayesianLMRegressor(hidden=0).fit(*_product(20))
