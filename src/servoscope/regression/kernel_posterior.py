"""What samples say of the target elsewhere, under a Gaussian kernel."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from servoscope.kernels import GaussianKernel, inverse_covariance
from servoscope.processes import one_blas_thread
from servoscope.regression.samples import Array, Samples


@dataclass(frozen=True, eq=False)
class KernelPosterior:
    """A Gaussian process given samples of it.

    Parameters
    ----------
    kernel : GaussianKernel
    samples : Samples

    Attributes
    ----------
    inverse : ndarray of shape (n, n)
        Of the covariance of the targets.
    weights : ndarray of shape (n,)
        Of the covariances with the samples, which add up to the prediction.

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
    >>> posterior = KernelPosterior(kernel, Samples(np.array([[0.0]]), np.array([1.0])))
    >>> posterior.mean(np.array([[0.0], [9.0]])).round(3)
    array([0.99, 0.  ])
    >>> posterior.deviation(np.array([[0.0], [9.0]])).round(3)
    array([0.141, 1.005])
    """

    kernel: GaussianKernel
    samples: Samples
    inverse: Array = field(init=False, repr=False)
    weights: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        n = len(self.samples.y)
        inverse = np.zeros((n, n))
        with one_blas_thread():
            if self.kernel.signal:
                inverse, _ = inverse_covariance(self.kernel, self.samples.X)
            weights = inverse @ (self.samples.y - self.kernel.offset)
        object.__setattr__(self, "inverse", inverse)
        object.__setattr__(self, "weights", weights)

    def mean(self, X: Array) -> Array:
        """The target to expect at samples X, (n,)."""
        return self.kernel.offset + self.kernel(X, self.samples.X) @ self.weights

    def deviation(self, X: Array) -> Array:
        """Standard deviation of a target at samples X, (n,)."""
        covariances = self.kernel(X, self.samples.X)
        told = np.einsum("ij,ij->i", covariances @ self.inverse, covariances)
        return np.sqrt(np.maximum(self.kernel.signal**2 - told, 0) + self.kernel.noise**2)

    def residuals_left_out(self) -> Array:
        """Target less its prediction from all the other samples, at each sample, (n,)."""
        if not self.kernel.signal:
            n = len(self.samples.y)
            return (self.samples.y - self.kernel.offset) * n / max(n - 1, 1)
        return self.weights / np.diag(self.inverse)

    def gradient(self, X: Array) -> Array:
        """Derivatives of `mean` by the features, (n, n_features)."""
        here, there = self.kernel.scaled(X), self.kernel.scaled(self.samples.X)
        shares = self.kernel(X, self.samples.X) * self.weights
        return (shares @ there - shares.sum(axis=1)[:, None] * here) / self.kernel.length_scales
