"""A scikit-learn regressor: kernel ridge with one length scale, chosen by leaving samples out."""

from __future__ import annotations

import numpy as np

from servoscope.kernels import GaussianKernel
from servoscope.kernels.gaussian import squared_distances
from servoscope.processes import one_blas_thread
from servoscope.regression.kernel_regressor import KERNEL_SAMPLES, KernelRegressor, drawn
from servoscope.regression.samples import Array, Samples

LENGTH_SCALES = np.array([0.5, 1.0, 2.0, 4.0, 8.0, 16.0])
"""Tried, in units of the root of the number of features, for features of unit variance."""

RIDGES = 10.0 ** np.arange(-7, 1, 0.5)
"""Variances of the noise tried, in units of the signal's."""


class GaussianKernelRidge(KernelRegressor):
    """Kernel ridge regression with one length scale for all features.

    The features are standardised. Length scale and ridge are those of a grid with the least
    error at samples left out, among at most 600 samples. The predicted standard deviation is that
    of the Gaussian process of the same kernel, its signal such that the errors at samples left
    out are as large as it says. Validation samples are not needed; those that `fit` is given set
    the size of the standard deviation instead, and are then learned from like the others.

    Parameters
    ----------
    max_samples : int
        Of more samples than that, so many drawn at random are learned from, always the same
        ones: memory grows with their square and time with their cube.

    Attributes
    ----------
    kernel_ : GaussianKernel
        Length scales, signal and noise in the units of the features and the target.
    posterior_ : KernelPosterior
        The kernel with the samples.
    n_features_in_ : int
    feature_names_in_ : ndarray of shape (n_features_in_,)
        Only where X had names.

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
