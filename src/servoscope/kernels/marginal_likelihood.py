"""Length scales, signal and noise under which the targets are likeliest."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from servoscope.kernels.gaussian import JITTER, Array, GaussianKernel, invert, squared_distances
from servoscope.processes import one_blas_thread

PRIOR_WEIGHT, PRIOR_PRECISION = 0.1, 0.02
"""A feature's inverse length scale is log-normal about the former, with the latter's precision:
weak, and enough to keep uninformative features apart."""

_STARTS = ((1.0, 0.1), (4.0, 0.03), (12.0, 0.03))
"""Inverse length scales, as multiples of the usual ones, and noise to search from: where the
target bends often, longer length scales end at noise alone."""

_TRIAL_SAMPLES, _TRIAL_ITERATIONS = 100, 20
"""On so many samples, for so long, starts other than the first show whether they lead further;
a search that is to be shorter than that is made from the first alone."""

_WEIGHT_BOUNDS, _SIGNAL_BOUNDS, _NOISE_BOUNDS = (-9.0, 3.0), (-3.0, 4.0), (-9.0, 1.0)


class _Samples(NamedTuple):
    X: Array
    y: Array


def fit_kernel(X: Array, y: Array, *, max_iter: int = 60, max_samples: int = 600) -> GaussianKernel:
    """The kernel of largest marginal likelihood, found by L-BFGS from several starts.

    Parameters
    ----------
    X : ndarray of shape (n, n_features)
    y : ndarray of shape (n,)
    max_iter : int
    max_samples : int
        Of more samples than that, so many drawn at random decide; always the same ones.

    Returns
    -------
    GaussianKernel
        In the units of the features and the target. A constant feature has no say; a constant
        target has no signal.

    Notes
    -----
    Maximises eq. 5.8 of [1]_ over the logarithms of the inverse length scales, of the signal and
    of the noise, with gradient eq. 5.9; features and target are standardised meanwhile.

    References
    ----------
    .. [1] C. Rasmussen and C. Williams, "Gaussian processes for machine learning", MIT Press,
       2006.

    Examples
    --------
    >>> X = np.random.default_rng(0).uniform(-1, 1, (200, 2))
    >>> kernel = fit_kernel(X, np.sin(3 * X[:, 0]))
    >>> bool(kernel.length_scales[0] < 0.1 * kernel.length_scales[1])
    True
    """
    if len(y) > max_samples:
        chosen = np.sort(np.random.default_rng(0).permutation(len(y))[:max_samples])
        X, y = X[chosen], y[chosen]
    centre, spread = X.mean(axis=0), X.std(axis=0)
    spread[spread <= 1e-12 * np.abs(centre)] = np.inf
    offset, scale = float(y.mean()), float(y.std())
    if scale <= 1e-12 * abs(offset) or not np.isfinite(spread).any():
        return GaussianKernel(centre, np.full(len(centre), np.inf), 0.0, scale, offset)
    varies = np.isfinite(spread)
    samples = _Samples((X[:, varies] - centre[varies]) / spread[varies], (y - offset) / scale)
    with one_blas_thread():
        weights, signal, noise = _maximise(samples, max_iter)
    length_scales = np.full(len(centre), np.inf)
    length_scales[varies] = spread[varies] / weights
    return GaussianKernel(centre, length_scales, signal * scale, noise * scale, offset)


def _maximise(samples: _Samples, max_iter: int) -> tuple[Array, float, float]:
    first, *others = (_start(samples.X.shape[1], *start) for start in _STARTS)
    if max_iter < _TRIAL_ITERATIONS:
        others = []
    best, least = _search(samples, first, max_iter)
    step = -(-len(samples.y) // _TRIAL_SAMPLES)
    few = _Samples(samples.X[::step], samples.y[::step])
    for start in others:
        trial, _ = _search(few, start, _TRIAL_ITERATIONS)
        if negative_log_likelihood(trial, *samples)[0] < least:
            trial, value = _search(samples, trial, max_iter)
            if value < least:
                best, least = trial, value
    parameters = np.exp(best)
    return parameters[:-2], float(parameters[-2]), float(parameters[-1])


def _start(n_features: int, factor: float, noise: float) -> Array:
    start = np.full(n_features + 2, np.log(factor) - np.log(2 * np.sqrt(n_features)))
    start[-2:] = 0.0, np.log(noise)
    return start


def _search(samples: _Samples, start: Array, max_iter: int) -> tuple[Array, float]:
    """Parameters of the largest likelihood from a start, and minus its logarithm."""
    bounds = [_WEIGHT_BOUNDS] * samples.X.shape[1] + [_SIGNAL_BOUNDS, _NOISE_BOUNDS]

    def per_sample(parameters: Array) -> tuple[float, Array]:
        # The first step is as long as the gradient: that of all samples leads into poor optima.
        value, gradient = negative_log_likelihood(parameters, samples.X, samples.y)
        return value / len(samples.y), gradient / len(samples.y)

    found = minimize(
        per_sample,
        start,
        jac=True,
        method="L-BFGS-B",
        bounds=bounds,
        options={"maxiter": max_iter},
    )
    return found.x, len(samples.y) * float(found.fun)


def negative_log_likelihood(parameters: Array, X: Array, y: Array) -> tuple[float, Array]:
    """Minus the log marginal likelihood and log prior, up to a constant, and its gradient.

    Parameters
    ----------
    parameters : ndarray of shape (n_features + 2,)
        Logarithms of the inverse length scales, of the signal and of the noise.
    X : ndarray of shape (n, n_features)
    y : ndarray of shape (n,)
    """
    weights, (signal, noise) = np.exp(parameters[:-2]), np.exp(parameters[-2:])
    S = X * weights
    explained = signal**2 * np.exp(-0.5 * squared_distances(S, S))
    inverse, half_log_determinant = invert(explained, noise**2 + JITTER * signal**2)
    alpha = inverse @ y
    away = parameters[:-2] - np.log(PRIOR_WEIGHT)
    value = 0.5 * y @ alpha + half_log_determinant + 0.5 * PRIOR_PRECISION * away @ away
    slope: NDArray[np.float64] = inverse
    slope -= np.outer(alpha, alpha)
    trace = np.trace(slope)
    slope *= explained
    gradient = np.empty_like(parameters)
    gradient[:-2] = _distance_gradient(slope, S) + PRIOR_PRECISION * away
    gradient[-2] = slope.sum() + JITTER * signal**2 * trace
    gradient[-1] = noise**2 * trace
    return float(value), gradient


def _distance_gradient(slope: Array, S: Array) -> Array:
    """By the log of each weight: ``-1/2 sum_ij slope_ij (s_i - s_j)^2`` for each column of S."""
    return np.asarray(
        np.einsum("ij,ij->j", slope @ S, S) - np.einsum("i,ij,ij->j", slope.sum(axis=1), S, S)
    )
