"""How sure an RMS error is that was measured on some samples."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm, t

Array = NDArray[np.float64]


def rms_interval(
    residuals: Array,
    groups: NDArray[np.intp] | None = None,
    coverage: float = 0.9,
    other_error: float = 0.0,
) -> Array:
    """Interval for the RMS of residuals of which some are known.

    Parameters
    ----------
    residuals : ndarray of shape (n, n_targets)
    groups : ndarray of shape (n,), optional
        Groups that are independent of each other, where single residuals are not; two at least.
    coverage : float
        How often the interval shall hold the RMS of infinitely many residuals.
    other_error : float
        Standard error of the logarithm of the RMS that has other causes than the number of
        residuals.

    Returns
    -------
    ndarray of shape (2, n_targets)
        Lower and upper end, in the unit of the residuals.

    Notes
    -----
    The RMS times or over ``exp(t s)``, with `s` the standard error of the logarithm of the RMS and
    `t` the quantile of Student's distribution for as many groups. A nominal 90 % holds 84 to 91 %
    of the time from 4 groups up where residuals are normal, alike within a group or not, and less
    where few of them outweigh all others; a bootstrap of 4 groups holds 73 %.

    Examples
    --------
    >>> residuals = np.random.default_rng(0).normal(size=(1000, 1))
    >>> rms_interval(residuals).round(2)
    array([[0.94],
           [1.02]])
    """
    rms = np.sqrt(np.mean(residuals**2, axis=0))
    error, n_groups = rms_log_error(residuals, groups)
    tail = (1 - coverage) / 2
    reach = np.hypot(t.isf(tail, n_groups - 1) * error, norm.isf(tail) * other_error)
    return np.array([rms * np.exp(-reach), rms * np.exp(reach)])


def rms_log_error(residuals: Array, groups: NDArray[np.intp] | None = None) -> tuple[Array, int]:
    """Standard error of the logarithm of an RMS, and the number of groups it is from.

    Parameters
    ----------
    residuals : ndarray of shape (n, n_targets)
    groups : ndarray of shape (n,), optional

    Returns
    -------
    error : ndarray of shape (n_targets,)
        0 where all residuals are.
    n_groups : int
    """
    squares, sizes = residuals**2, np.ones(len(residuals))
    if groups is not None:
        _, members = np.unique(groups, return_inverse=True)
        sizes = np.bincount(members).astype(float)
        sums = np.zeros((len(sizes), squares.shape[1]))
        np.add.at(sums, members, squares)
        squares = sums
    n_groups = len(sizes)
    mean = squares.sum(axis=0) / sizes.sum()
    excess = squares - np.multiply.outer(sizes, mean)
    deviation = np.sqrt(n_groups / (n_groups - 1) * np.square(excess).sum(axis=0)) / sizes.sum()
    return 0.5 * deviation / np.where(mean > 0, mean, 1.0), n_groups
