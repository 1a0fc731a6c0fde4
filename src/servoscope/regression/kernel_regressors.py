"""Regressors over Gaussian kernels: a Gaussian process, and kernel ridge regression."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from sklearn.utils.validation import check_is_fitted

from servoscope.errors import InvalidInputError
from servoscope.kernels import GaussianKernel, KernelPosterior, fit_kernel
from servoscope.kernels.gaussian import squared_distances
from servoscope.processes import one_blas_thread
from servoscope.regression.samples import (
    Array,
    SampleRegressor,
    Samples,
    Shots,
    calibration_ratio,
    check_arrays,
    least_deviation,
)

KERNEL_SAMPLES = 600
"""Of more samples than that, so many decide on the kernel."""

_ARRAYS = ("centre", "length_scales", "signal", "noise", "offset", "samples", "targets")


class KernelRegressor(SampleRegressor):
    """The target as a Gaussian process; subclasses find its kernel."""

    max_samples: int
    posterior_: KernelPosterior

    @abstractmethod
    def _find_kernel(self, samples: Samples) -> GaussianKernel:
        """The kernel under which the samples are to be seen."""

    def _check_parameters(self) -> None:
        if self.max_samples < 1:
            raise InvalidInputError(f"max_samples must be at least 1, got {self.max_samples}.")

    def _learn(self, learned: Shots, others: Shots | None) -> None:
        training = drawn(learned.poses, self.max_samples)
        samples, kernel = training, self._find_kernel(training)
        if others is None:
            factor = _spread_of_shots(KernelPosterior(kernel, *training), learned)
        else:
            samples = drawn(training.joined(others.poses), self.max_samples)
            posterior = KernelPosterior(kernel, *training)
            errors = others.each.y - posterior.mean(others.each.X)
            factor = calibration_ratio(errors, posterior.deviation(others.each.X))
            if len(training.y) < KERNEL_SAMPLES:
                kernel = self._find_kernel(samples)
        noise = factor * kernel.noise or least_deviation(samples.y)
        if not kernel.signal and len(samples.y) > 1:  # about the mean of the other samples
            noise *= len(samples.y) / (len(samples.y) - 1)
        kernel = replace(kernel, signal=factor * kernel.signal, noise=noise)
        self.posterior_ = KernelPosterior(kernel, *samples)

    def _mean(self, X: Array) -> Array:
        return self.posterior_.mean(X)

    def _deviation(self, X: Array) -> Array:
        return self.posterior_.deviation(X)

    def gradient(self, X: ArrayLike) -> Array:
        """Derivatives of the prediction by each feature at samples X, (n, n_features_in_)."""
        return self.posterior_.gradient(self._check_features(X))

    @property
    def kernel_(self) -> GaussianKernel:
        """The kernel that was found."""
        return self.posterior_.kernel

    def to_arrays(self) -> dict[str, np.ndarray]:
        """What `predict` needs, as plain arrays that `numpy.savez` writes without pickle."""
        check_is_fitted(self)
        kernel, posterior = self.kernel_, self.posterior_
        values = (
            *(kernel.centre, kernel.length_scales, kernel.signal, kernel.noise, kernel.offset),
            *(posterior.X, posterior.y),
        )
        arrays = {name: np.asarray(value) for name, value in zip(_ARRAYS, values, strict=True)}
        scales = arrays["length_scales"]  # a feature that has no say: 0 for infinity
        arrays["length_scales"] = np.where(np.isfinite(scales), scales, 0.0)
        return self._with_names(arrays)

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, ArrayLike]) -> Self:
        """A regressor that predicts as the one that `to_arrays` was called on."""
        values = check_arrays(arrays, _ARRAYS, "A kernel regressor")
        centre, length_scales, signal, noise, offset, X, y = values
        n_features = centre.size
        if length_scales.size != n_features or X.shape != (y.size, n_features):
            raise InvalidInputError(
                f"{length_scales.size} length scales, {y.size} targets and samples of shape "
                f"{X.shape} do not belong together: the arrays are not of one regressor."
            )
        length_scales = np.where(length_scales > 0, length_scales, np.inf)
        kernel = GaussianKernel(centre, length_scales, float(signal), float(noise), float(offset))
        regressor = cls()
        regressor.posterior_ = KernelPosterior(kernel, X, y)
        regressor._take_names(n_features, arrays)
        return regressor


def _spread_of_shots(posterior: KernelPosterior, shots: Shots) -> float:
    """By how much single shots are further from what other poses predict than their means are."""
    if shots.poses is shots.each:
        return 1.0
    within = shots.noise_within(shots.each.y - posterior.mean(shots.each.X))
    left_out = np.mean(np.square(posterior.residuals_left_out()))
    return float(np.sqrt(1 + within / left_out)) if left_out else 1.0


def drawn(samples: Samples, n: int) -> Samples:
    """At most `n` of the samples, always the same ones."""
    if len(samples.y) <= n:
        return samples
    chosen = np.sort(np.random.default_rng(1).permutation(len(samples.y))[:n])
    return Samples(samples.X[chosen], samples.y[chosen])


class GaussianProcess(KernelRegressor):
    """A Gaussian process whose length scales show how much each feature matters.

    Length scales, signal and noise are those of the largest marginal likelihood of at most 600
    training samples; from the rest, up to `max_samples` in all, the predictions learn as well.
    Validation samples are not needed; those that `fit` is given set the size of the predicted
    standard deviation, and are then learned from like the others.

    Parameters
    ----------
    max_samples : int
        Of more samples than that, so many drawn at random are learned from, always the same
        ones: memory grows with their square and time with their cube.
    kernel_steps : int
        Most steps of the search for the kernel.

    Attributes
    ----------
    kernel_ : GaussianKernel
        Length scales, signal and noise in the units of the features and the target.
    posterior_ : KernelPosterior
        The kernel with the samples.
    n_features_in_ : int
    feature_names_in_ : ndarray of shape (n_features_in_,)
        Only where X had names.

    Examples
    --------
    >>> import numpy as np
    >>> X = np.random.default_rng(0).uniform(-1, 1, (100, 2))
    >>> process = GaussianProcess().fit(X, np.sin(2 * X[:, 0]) * X[:, 1])
    >>> y, std = process.predict([[0.5, 0.5], [9.0, 9.0]], return_std=True)
    >>> bool(abs(y[0] - np.sin(1.0) * 0.5) < 0.01), bool(std[1] > 10 * std[0])
    (True, True)
    """

    def __init__(self, max_samples: int = 2000, kernel_steps: int = 60) -> None:
        self.max_samples = max_samples
        self.kernel_steps = kernel_steps

    def _find_kernel(self, samples: Samples) -> GaussianKernel:
        return fit_kernel(*samples, max_samples=KERNEL_SAMPLES, max_iter=self.kernel_steps)


LENGTH_SCALES = np.array([0.5, 1.0, 2.0, 4.0, 8.0, 16.0])
"""Tried, in units of the root of the number of features, for features of unit variance."""

RIDGES = 10.0 ** np.arange(-7, 1, 0.5)
"""Variances of the noise tried, in units of the signal's."""


class GaussianKernelRidge(KernelRegressor):
    """Kernel ridge regression with one length scale for all features.

    The features are standardised. Length scale and ridge are those of a grid with the least error
    at samples left out, among at most 600 samples. The predicted standard deviation is that of the
    Gaussian process of the same kernel, its signal such that the errors at samples left out are as
    large as it says. Validation samples, `max_samples` and attributes are as of `GaussianProcess`.

    Notes
    -----
    With the eigenvectors of the kernel matrix, the inverse for every ridge costs no more than a
    product, and the errors left out are ``(G y)_i / G_ii`` (`servoscope.kernels`).

    Examples
    --------
    >>> X = np.random.default_rng(0).uniform(-1, 1, (100, 2))
    >>> ridge = GaussianKernelRidge().fit(X, np.sin(2 * X[:, 0]) * X[:, 1])
    >>> bool(abs(ridge.predict([[0.5, 0.5]])[0] - np.sin(1.0) * 0.5) < 0.01)
    True
    """

    def __init__(self, max_samples: int = 2000) -> None:
        self.max_samples = max_samples

    def _find_kernel(self, samples: Samples) -> GaussianKernel:
        X, y = drawn(samples, KERNEL_SAMPLES)
        centre, offset = X.mean(axis=0), float(y.mean())
        spread = X.std(axis=0)
        spread[spread <= 1e-12 * np.abs(X).max(axis=0)] = np.inf
        n_told = np.isfinite(spread).sum()
        if not n_told or np.ptp(y) <= 1e-12 * np.abs(y).max():
            return GaussianKernel(centre, np.full(len(centre), np.inf), 0.0, float(y.std()), offset)
        distances = squared_distances(*2 * [(X - centre) / (spread * np.sqrt(n_told))])
        length_scale, noise, signal = _search(distances, y - offset)
        scales = length_scale * np.sqrt(n_told) * spread
        return GaussianKernel(centre, scales, signal, noise * signal, offset)


def _search(distances: Array, y: Array) -> tuple[float, float, float]:
    """Length scale, noise in units of the signal, and signal of least error left out."""
    best, least = (1.0, 1.0, 1.0), np.inf
    with one_blas_thread():
        for length_scale in LENGTH_SCALES:
            values, vectors = np.linalg.eigh(np.exp(-0.5 * distances / length_scale**2))
            gains = 1 / (np.maximum(values, 0)[:, None] + RIDGES)
            weights = vectors @ (gains * (y @ vectors)[:, None])
            precisions = vectors**2 @ gains
            errors = np.mean((weights / precisions) ** 2, axis=0)
            i = int(np.argmin(errors))
            if errors[i] < least:
                least = errors[i]
                signal = np.sqrt(np.mean(weights[:, i] ** 2 / precisions[:, i]))
                best = float(length_scale), float(np.sqrt(RIDGES[i])), float(signal)
    return best
