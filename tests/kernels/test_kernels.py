"""Gaussian kernels against scikit-learn, finite differences, and models fitted anew."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import approx_fprime
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

from servoscope.errors import InvalidInputError
from servoscope.kernels import (
    GaussianKernel,
    fit_kernel,
    inverse_covariance,
    leave_out_residuals,
)
from servoscope.kernels.gaussian import PRIOR_PRECISION, negative_log_likelihood


@pytest.fixture
def samples():
    rng = np.random.default_rng(0)
    X = rng.normal(size=(60, 3)) * [1.0, 10.0, 0.1]
    return X, np.sin(X[:, 0]) + 0.05 * X[:, 1] + 0.1 * rng.normal(size=60)


KERNEL = GaussianKernel(
    centre=np.array([0.1, 0.0, 0.0]),
    length_scales=np.array([0.8, 20.0, 0.5]),
    signal=1.3,
    noise=0.1,
    offset=0.2,
)


def predict(kernel, X, y, at):
    inverse, _ = inverse_covariance(kernel, X)
    return kernel.offset + kernel(at, X) @ (inverse @ (y - kernel.offset))


def test_covariances_are_those_of_scikit_learn(samples):
    X, _ = samples
    expected = 1.3**2 * RBF(KERNEL.length_scales)(X, X[:7])
    np.testing.assert_allclose(KERNEL(X, X[:7]), expected, atol=1e-12)


def test_the_likelihood_is_that_of_scikit_learn(samples):
    X, y = samples
    parameters = np.log([1 / 0.8, 1 / 20.0, 1 / 0.5, 1.3, 0.1])
    kernel = ConstantKernel(1.3**2) * RBF([0.8, 20.0, 0.5]) + WhiteKernel(0.01)
    process = GaussianProcessRegressor(kernel, optimizer=None, alpha=0).fit(X, y)
    prior = 0.5 * PRIOR_PRECISION * np.sum((parameters[:3] - np.log(0.1)) ** 2)
    expected = -process.log_marginal_likelihood() - 0.5 * len(y) * np.log(2 * np.pi) + prior
    assert negative_log_likelihood(parameters, X, y)[0] == pytest.approx(expected, rel=1e-6)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10**6))
def test_the_gradient_of_the_likelihood_is_its_finite_difference(seed):
    rng = np.random.default_rng(seed)
    X, parameters = rng.normal(size=(30, 4)), 0.5 * rng.normal(size=6)
    y = X[:, 0] ** 2 + 0.1 * rng.normal(size=30)
    gradient = negative_log_likelihood(parameters, X, y)[1]
    expected = approx_fprime(parameters, lambda p: negative_log_likelihood(p, X, y)[0], 1e-6)
    np.testing.assert_allclose(gradient, expected, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("n_groups", [12, 5, 2])
def test_residuals_are_those_of_models_without_the_group(samples, n_groups):
    X, y = samples
    groups = np.arange(len(y)) % n_groups
    residuals = leave_out_residuals(KERNEL, X, y, groups)
    for group in range(n_groups):
        out = groups == group
        expected = y[out] - predict(KERNEL, X[~out], y[~out], X[out])
        np.testing.assert_allclose(residuals[out], expected, atol=1e-8)


def test_without_groups_each_sample_is_left_out_by_itself(samples):
    X, y = samples
    alone = leave_out_residuals(KERNEL, X, y)
    np.testing.assert_allclose(alone, leave_out_residuals(KERNEL, X, y, np.arange(60)), atol=1e-10)


def test_the_fit_finds_which_features_inform_and_how_much_noise_there_is():
    rng = np.random.default_rng(1)
    X = rng.uniform(-1, 1, (300, 4))
    kernel = fit_kernel(X, np.sin(3 * X[:, 1]) + X[:, 3] + 0.05 * rng.normal(size=300))
    assert kernel.noise == pytest.approx(0.05, rel=0.2)
    assert kernel.length_scales[[1, 3]].max() < 0.1 * kernel.length_scales[[0, 2]].min()


@settings(max_examples=10, deadline=None)
@given(st.floats(1e-3, 1e3), st.floats(-100, 100), st.floats(1e-3, 1e3))
def test_the_fit_does_not_depend_on_units(factor, shift, target_factor):
    rng = np.random.default_rng(2)
    X = rng.uniform(-1, 1, (40, 2))
    y = X[:, 0] ** 2 + 0.1 * rng.normal(size=40)
    one = fit_kernel(X, y, max_iter=5)
    other = fit_kernel(factor * X + shift, target_factor * y, max_iter=5)
    np.testing.assert_allclose(other.length_scales, factor * one.length_scales, rtol=1e-3)
    assert other.noise == pytest.approx(target_factor * one.noise, rel=1e-3)


def test_constant_features_have_no_say_and_constant_targets_no_signal(samples):
    X, y = samples
    X = np.column_stack([X, np.full(60, 7.0)])
    assert np.isinf(fit_kernel(X, y, max_iter=5).length_scales[3])
    still = fit_kernel(X, np.full(60, 3.0))
    assert (still.signal, still.noise, still.offset) == (0.0, 0.0, 3.0)
    uninformed = fit_kernel(np.ones((60, 2)), y)
    assert (uninformed.signal, uninformed.noise) == (0.0, pytest.approx(y.std()))


def test_repeated_samples_have_finite_residuals():
    X = np.repeat(np.linspace(0, 1, 20), 2)[:, None]
    kernel = fit_kernel(X, np.sin(5 * X[:, 0]))
    assert np.isfinite(leave_out_residuals(kernel, X, np.sin(5 * X[:, 0]))).all()


def test_what_is_not_positive_definite_is_refused():
    kernel = GaussianKernel(np.zeros(1), np.ones(1), signal=0.0, noise=0.0)
    with pytest.raises(InvalidInputError, match="not positive definite"):
        inverse_covariance(kernel, np.zeros((3, 1)))


@pytest.mark.parametrize("seed", range(2))
def test_long_first_steps_do_not_lead_into_poor_optima(seed):
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(500, 6))
    y = np.sin(2 * X[:, 0]) + 0.3 * X[:, 1] + 0.02 * rng.normal(size=500)
    kernel = fit_kernel(X[:400], y[:400])
    errors = predict(kernel, X[:400], y[:400], X[400:]) - y[400:]
    assert np.sqrt(np.mean(errors**2)) < 0.04
