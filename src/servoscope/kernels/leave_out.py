"""Errors at samples left out, without fitting again."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from servoscope.kernels.gaussian import Array, GaussianKernel, inverse_covariance


def leave_out_residuals(
    kernel: GaussianKernel, X: Array, y: Array, groups: NDArray[np.intp] | None = None
) -> Array:
    """Target minus prediction at every sample, from all the samples of other groups.

    Parameters
    ----------
    kernel : GaussianKernel
    X : ndarray of shape (n, n_features)
    y : ndarray of shape (n,)
    groups : ndarray of shape (n,), optional
        Which samples are left out together; by default each by itself.

    Returns
    -------
    ndarray of shape (n,)
        In the target's unit.

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

    Parameters
    ----------
    kernel : GaussianKernel
    X, y : ndarrays of shape (n, n_features) and (n,)
        Samples, such as the means of repeated shots.
    groups : ndarray of shape (n,), optional
        Which samples are left out together; by default each by itself.
    shots : ndarrays of shape (n_shots, n_features), (n_shots,) and (n_shots,)
        Features, targets, and which sample each is a shot of.

    Returns
    -------
    ndarray of shape (n_shots,)
        In the target's unit.

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
