"""What the regressors over Gaussian kernels share: all but how the kernel is found."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from typing import Literal, Self, overload

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.utils.validation import check_is_fitted, validate_data

from servoscope.arrays import check_scale, check_unmasked
from servoscope.errors import InvalidInputError
from servoscope.kernels import GaussianKernel, KernelPosterior
from servoscope.regression.calibration_ratio import calibration_ratio
from servoscope.regression.samples import (
    Array,
    Samples,
    Shots,
    check_arrays,
    check_samples,
    least_deviation,
)

KERNEL_SAMPLES = 600
"""Of more samples than that, so many decide on the kernel."""

_ARRAYS = ("centre", "length_scales", "signal", "noise", "offset", "samples", "targets")


class KernelRegressor(RegressorMixin, BaseEstimator):
    """The target as a Gaussian process; subclasses find its kernel."""

    max_samples: int
    posterior_: KernelPosterior

    @abstractmethod
    def _find_kernel(self, samples: Samples) -> GaussianKernel:
        """The kernel under which the samples are to be seen."""

    def fit(
        self,
        X: ArrayLike,
        y: ArrayLike,
        X_val: ArrayLike | None = None,
        y_val: ArrayLike | None = None,
        poses: ArrayLike | None = None,
    ) -> Self:
        """Learn from samples X (n, k) and y (n,).

        Parameters
        ----------
        X, y : arrays of shape (n, n_features) and (n,)
            Two samples at least.
        X_val, y_val : arrays of shape (n_val, n_features) and (n_val,), optional
            More samples to learn from, once it is seen how large the errors at them are: by as
            much the predicted standard deviation is raised or lowered.
        poses : array of shape (n,) or (n + n_val,), optional
            Samples of equal value are repeated shots of one pose, which count as one sample, their
            mean. By default they are found (`servoscope.kernels.find_repeats`).

        Raises
        ------
        InvalidInputError
            If `max_samples` is below 1, only one of X_val and y_val is given, or values are masked
            or beyond 1e30.
        ValueError
            If an array is empty, has the wrong shape or holds NaN or infinity, or there is one
            sample only.
        """
        if self.max_samples < 1:
            raise InvalidInputError(f"max_samples must be at least 1, got {self.max_samples}.")
        learned, others = check_samples(self, X, y, X_val, y_val, poses)
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
        return self

    @overload
    def predict(self, X: ArrayLike, return_std: Literal[False] = False) -> Array: ...
    @overload
    def predict(self, X: ArrayLike, return_std: Literal[True]) -> tuple[Array, Array]: ...
    def predict(self, X: ArrayLike, return_std: bool = False) -> Array | tuple[Array, Array]:
        """The target at samples X of shape (n, n_features_in_).

        Parameters
        ----------
        X : array of shape (n, n_features_in_)
        return_std : bool

        Returns
        -------
        y : ndarray of shape (n,)
        std : ndarray of shape (n,)
            Only if `return_std`: the standard deviation of a new target, its noise included.
        """
        samples = self._check_features(X)
        mean = self.posterior_.mean(samples)
        return (mean, self.posterior_.deviation(samples)) if return_std else mean

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
        if hasattr(self, "feature_names_in_"):
            arrays["feature_names"] = np.asarray(self.feature_names_in_, dtype=str)
        return arrays

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, ArrayLike]) -> Self:
        """A regressor that predicts as the one that `to_arrays` was called on.

        Raises
        ------
        InvalidInputError
            If an array is missing or the sizes disagree.
        """
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
        regressor.n_features_in_ = n_features
        if "feature_names" in arrays:
            regressor.feature_names_in_ = np.asarray(arrays["feature_names"], dtype=object)
        return regressor

    def _check_features(self, X: ArrayLike) -> Array:
        check_is_fitted(self)
        check_unmasked(X, "X")
        features = np.asarray(validate_data(self, X, reset=False, dtype=np.float64))
        check_scale(features, "X")
        return features


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
