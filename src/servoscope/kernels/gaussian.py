"""Gaussian processes: the kernel and how it is found, the posterior, errors at samples left out."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import blas, lapack
from scipy.optimize import minimize

from servoscope.compiled import compiled
from servoscope.errors import InvalidInputError
from servoscope.processes import one_blas_thread

Array = NDArray[np.float64]

JITTER = 1e-9
"""Share of the signal's variance that is added to the noise's, so that matrices have inverses."""


@dataclass(frozen=True, eq=False)
class GaussianKernel:
    """Covariance of the targets of two samples.

    k(a, b) = signal^2 exp(-1/2 sum_d ((a_d - b_d) / length_scales_d)^2)

    A length scale, in the feature's own unit, is how far it has to go until the target is another;
    infinite for one that the target does not depend on. Signal and noise are the standard
    deviations of what the features explain of the target and of what they do not; `offset` is the
    target where nothing is known. The centre is taken from features for the sake of precision
    alone.

    Examples
    --------
    >>> kernel = GaussianKernel(np.zeros(2), np.array([1.0, np.inf]), signal=2.0, noise=0.1)
    >>> kernel(np.array([[0.0, 0.0]]), np.array([[0.0, 5.0], [1.0, 0.0]])).round(3)
    array([[4.   , 2.426]])
    """

    centre: Array = field(repr=False)
    length_scales: Array
    signal: float
    noise: float
    offset: float = 0.0

    def __call__(self, A: Array, B: Array) -> Array:
        """Covariances of the explained targets at samples A and B, (len(A), len(B))."""
        return self.signal**2 * np.exp(-0.5 * squared_distances(self.scaled(A), self.scaled(B)))

    def scaled(self, X: Array) -> Array:
        """Samples in units of the length scales."""
        return (X - self.centre) / self.length_scales


def squared_distances(A: Array, B: Array) -> Array:
    """Squared Euclidean distances of the rows of A and B, (len(A), len(B))."""
    squares = np.einsum("ij,ij->i", A, A)[:, None] + np.einsum("ij,ij->i", B, B)
    squares -= 2 * (A @ B.T)
    return np.maximum(squares, 0, out=squares)


def inverse_covariance(kernel: GaussianKernel, X: Array) -> tuple[Array, float]:
    """Inverse of the covariance ``k(X, X) + noise^2 I``, and half the log of the covariance's
    determinant.
    """
    return invert(kernel(X, X), kernel.noise**2 + JITTER * kernel.signal**2)


def invert(covariance: Array, variance: float) -> tuple[Array, float]:
    """Inverse of a covariance with a variance on its diagonal, and half its log determinant."""
    covariance = np.array(covariance, order="F")
    covariance[np.diag_indices_from(covariance)] += variance
    factor, failed = lapack.dpotrf(covariance, lower=True, clean=False, overwrite_a=True)
    _check_definite(failed)
    half_log_determinant = float(np.log(np.diag(factor)).sum())
    inverse, _ = lapack.dpotri(factor, lower=True, overwrite_c=True)
    _mirror(inverse)
    return inverse, half_log_determinant


def _check_definite(failed: int) -> None:
    """Raise InvalidInputError if a matrix could not be factored."""
    if failed:
        raise InvalidInputError(
            "The covariance is not positive definite; samples are repeated or not finite."
        )


@compiled()
def _mirror(matrix: Array) -> None:
    """Fill the upper half with the lower one."""
    n, step = len(matrix), 32
    for j0 in range(0, n, step):
        for i0 in range(j0, n, step):
            for j in range(j0, min(j0 + step, n)):
                for i in range(max(i0, j + 1), min(i0 + step, n)):
                    matrix[j, i] = matrix[i, j]


def leave_out_residuals(
    kernel: GaussianKernel, X: Array, y: Array, groups: NDArray[np.intp] | None = None
) -> Array:
    """Target minus prediction (n,) at every sample, from all the samples of other groups.

    By default each sample is a group by itself.

    Notes
    -----
    With ``G`` the inverse of the covariance of all targets, the residuals at the samples ``B`` of
    a group are ``G_BB^-1 (G y)_B``; for a single sample that is the well-known
    ``(G y)_i / G_ii`` [1]_.

    References
    ----------
    .. [1] C. Rasmussen and C. Williams, "Gaussian processes for machine learning", MIT Press,
       2006, eq. 5.12.

    Examples
    --------
    >>> X = np.linspace(0, 1, 30)[:, None]
    >>> kernel = GaussianKernel(np.zeros(1), np.array([0.3]), signal=1.0, noise=1e-3)
    >>> bool(np.abs(leave_out_residuals(kernel, X, np.sin(4 * X[:, 0]))).max() < 0.01)
    True
    """
    inverse, _ = inverse_covariance(kernel, X)
    return _residuals(inverse, inverse @ (y - kernel.offset), groups)


def shots_left_out(
    kernel: GaussianKernel,
    X: Array,
    y: Array,
    groups: NDArray[np.intp] | None,
    shots: tuple[Array, Array, NDArray[np.intp]],
) -> Array:
    """Target minus prediction at single shots, from the samples of other groups than their own.

    The samples may be the means of repeated shots; `shots` are features, targets, and which sample
    each is a shot of. By default each sample is a group by itself.

    Notes
    -----
    With ``r`` the residuals of `leave_out_residuals`, leaving the samples ``B`` out changes the
    prediction at x by ``- k(x, X) G[:, B] r_B``.
    """
    X_shots, y_shots, members = shots
    inverse, _ = inverse_covariance(kernel, X)
    weights = inverse @ (y - kernel.offset)
    units = np.arange(len(y)) if groups is None else groups
    covariances = kernel(X_shots, X)
    own = units[members][:, None] == units
    by_own = np.where(own, covariances @ inverse, 0.0) @ _residuals(inverse, weights, groups)
    return np.asarray(y_shots - kernel.offset - covariances @ weights + by_own)


def _residuals(inverse: Array, weights: Array, groups: NDArray[np.intp] | None) -> Array:
    if groups is None:
        return np.asarray(weights / np.diag(inverse))
    residuals = np.empty_like(weights)
    for group in np.unique(groups):
        left_out = np.flatnonzero(groups == group)
        block = inverse[np.ix_(left_out, left_out)]
        residuals[left_out] = np.linalg.solve(block, weights[left_out])
    return residuals


@dataclass(frozen=True, eq=False)
class KernelPosterior:
    """A Gaussian process given samples of it:

    the inverse of the covariance of their targets, and the weights of the covariances with them,
    which add up to the prediction.

    Notes
    -----
    Eq. 2.25 and 2.26 of [1]_; the variance is that of a new target, noise included.

    References
    ----------
    .. [1] C. Rasmussen and C. Williams, "Gaussian processes for machine learning", MIT Press,
       2006.

    Examples
    --------
    >>> kernel = GaussianKernel(np.zeros(1), np.ones(1), signal=1.0, noise=0.1)
    >>> posterior = KernelPosterior(kernel, np.array([[0.0]]), np.array([1.0]))
    >>> posterior.mean(np.array([[0.0], [9.0]])).round(3)
    array([0.99, 0.  ])
    >>> posterior.deviation(np.array([[0.0], [9.0]])).round(3)
    array([0.141, 1.005])
    """

    kernel: GaussianKernel
    X: Array = field(repr=False)
    y: Array = field(repr=False)
    inverse: Array = field(init=False, repr=False)
    weights: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        n = len(self.y)
        inverse = np.zeros((n, n))
        with one_blas_thread():
            if self.kernel.signal:
                inverse, _ = inverse_covariance(self.kernel, self.X)
            weights = inverse @ (self.y - self.kernel.offset)
        object.__setattr__(self, "inverse", inverse)
        object.__setattr__(self, "weights", weights)

    def mean(self, X: Array) -> Array:
        """The target to expect at samples X, (n,)."""
        with one_blas_thread():
            return self.kernel.offset + self.kernel(X, self.X) @ self.weights

    def deviation(self, X: Array) -> Array:
        """Standard deviation of a target at samples X, (n,)."""
        with one_blas_thread():
            covariances = self.kernel(X, self.X)
            explained = np.einsum("ij,ij->i", covariances @ self.inverse, covariances)
        return np.sqrt(np.maximum(self.kernel.signal**2 - explained, 0) + self.kernel.noise**2)

    def residuals_left_out(self) -> Array:
        """Target less its prediction from all the other samples, at each sample, (n,)."""
        if not self.kernel.signal:
            n = len(self.y)
            return (self.y - self.kernel.offset) * n / max(n - 1, 1)
        return _residuals(self.inverse, self.weights, None)

    def gradient(self, X: Array) -> Array:
        """Derivatives of `mean` by the features, (n, n_features)."""
        here, there = self.kernel.scaled(X), self.kernel.scaled(self.X)
        with one_blas_thread():
            shares = self.kernel(X, self.X) * self.weights
            along = shares @ there
        return (along - shares.sum(axis=1)[:, None] * here) / self.kernel.length_scales


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

    Of more than `max_samples` so many drawn at random decide; always the same ones. A constant
    feature has no say; a constant target has no signal.

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

    The parameters are logarithms of the inverse length scales, of the signal and of the noise.
    """
    weights, (signal, noise) = np.exp(parameters[:-2]), np.exp(parameters[-2:])
    S = np.asfortranarray((X * weights).T)
    explained = blas.dsyrk(1.0, S, trans=1, lower=1)  # of all matrices the lower half counts
    factor = np.empty_like(explained)
    _explain(explained, factor, signal**2, noise**2 + JITTER * signal**2)
    factor, failed = lapack.dpotrf(factor, lower=1, clean=0, overwrite_a=1)
    _check_definite(failed)
    half_log_determinant = np.log(np.diag(factor)).sum()
    alpha, _ = lapack.dpotrs(factor, y, lower=1)
    away = parameters[:-2] - np.log(PRIOR_WEIGHT)
    value = 0.5 * y @ alpha + half_log_determinant + 0.5 * PRIOR_PRECISION * away @ away
    slope, _ = lapack.dpotri(factor, lower=1, overwrite_c=1)
    trace, total = _slope(slope, alpha, explained)
    gradient = np.empty_like(parameters)
    by_distance = blas.dsymm(1.0, slope, S, side=1, lower=1)
    gradient[:-2] = np.einsum("ij,ij->i", by_distance, S) + PRIOR_PRECISION * away
    gradient[-2] = total + JITTER * signal**2 * trace
    gradient[-1] = noise**2 * trace
    return float(value), gradient


@compiled()
def _explain(products: Array, covariance: Array, signal: float, noise: float) -> None:
    """Of the products of scaled samples their covariances, in place, and those of noisy targets."""
    n = len(products)
    squares = np.empty(n)
    for i in range(n):
        squares[i] = products[i, i]
    for j in range(n):
        for i in range(j, n):
            distance = max(squares[i] + squares[j] - 2 * products[i, j], 0.0)
            products[i, j] = signal * np.exp(-0.5 * distance)
            covariance[i, j] = products[i, j]
        covariance[j, j] += noise


@compiled()
def _slope(inverse: Array, alpha: Array, explained: Array) -> tuple[float, float]:
    """The slope by the distance of each two samples, in place of the inverse.

    Returns the trace of the slope by the covariances, and its sum over what is explained.
    """
    n = len(alpha)
    sums = np.zeros(n)
    trace = 0.0
    for j in range(n):
        trace += inverse[j, j] - alpha[j] * alpha[j]
        for i in range(j, n):
            inverse[i, j] = (inverse[i, j] - alpha[i] * alpha[j]) * explained[i, j]
            sums[i] += inverse[i, j]
            if i > j:
                sums[j] += inverse[i, j]
    for j in range(n):
        inverse[j, j] -= sums[j]
    return trace, sums.sum()
