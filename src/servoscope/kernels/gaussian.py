"""The Gaussian kernel with a length scale for each feature."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from servoscope.errors import InvalidInputError

Array = NDArray[np.float64]

JITTER = 1e-9
"""Share of the signal's variance that is added to the noise's, so that matrices have inverses."""


@dataclass(frozen=True, eq=False)
class GaussianKernel:
    """How much two samples tell of each other's target.

    ``k(a, b) = signal^2 exp(-1/2 sum_d ((a_d - b_d) / length_scales_d)^2)``

    Parameters
    ----------
    centre : ndarray of shape (n_features,)
        Taken from features before they are scaled, for the sake of precision alone.
    length_scales : ndarray of shape (n_features,)
        How far each feature has to go until the target is another, in the feature's own unit;
        infinite for one that has no say.
    signal : float
        Standard deviation of the target that the features explain, in the target's unit.
    noise : float
        Standard deviation of what they do not explain, in the target's unit.
    offset : float
        What the target is where nothing is known.

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
    """Inverse of the covariance of noisy targets at samples X, and half the log of its determinant.

    Parameters
    ----------
    kernel : GaussianKernel
    X : ndarray of shape (n, n_features)

    Returns
    -------
    inverse : ndarray of shape (n, n)
        Of ``k(X, X) + noise^2 I``.
    log_determinant : float
        Half of that of the covariance itself.
    """
    return invert(kernel(X, X), kernel.noise**2 + JITTER * kernel.signal**2)


def invert(covariance: Array, variance: float) -> tuple[Array, float]:
    """Inverse of a covariance with a variance added to its diagonal, and half its log determinant.

    Raises
    ------
    InvalidInputError
        If the sum is not positive definite.
    """
    covariance = np.array(covariance, order="F")
    covariance[np.diag_indices_from(covariance)] += variance
    factor, failed = lapack.dpotrf(covariance, lower=True, clean=False, overwrite_a=True)
    if failed:
        raise InvalidInputError(
            "The covariance is not positive definite; samples are repeated or not finite."
        )
    half_log_determinant = float(np.log(np.diag(factor)).sum())
    inverse, _ = lapack.dpotri(factor, lower=True, overwrite_c=True)
    lower = np.tril(inverse)
    lower += np.tril(lower, -1).T
    return lower, half_log_determinant
