"""How sure an RMS error is that was measured on some samples, and what others will show."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp
from scipy.stats import norm, t

Array = NDArray[np.float64]
Groups = NDArray[np.intp]

MOST_UNITS = 12
"""More groups than that are put together at random, so that their mean squares are log-normal."""

_LEAST_SHARE = 1e-6
_N_DRAWS = 4000


def root_mean_square(residuals: Array) -> Array:
    """Of every column."""
    return np.asarray(np.sqrt(np.mean(residuals**2, axis=0)))


def rms_interval(
    residuals: Array,
    groups: Groups | None = None,
    coverage: float = 0.9,
    other_error: float = 0.0,
) -> Array:
    """Interval for the RMS of infinitely many residuals, of which (n, n_targets) are known:

    its ends, (2, n_targets). Groups are independent of each other where single residuals are not,
    two at least. `other_error` is the standard error of the logarithm that has other causes than
    the number of residuals.

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
    rms = root_mean_square(residuals)
    error, n_groups = rms_log_error(residuals, groups)
    tail = (1 - coverage) / 2
    reach = np.hypot(t.isf(tail, n_groups - 1) * error, norm.isf(tail) * other_error)
    return np.array([rms * np.exp(-reach), rms * np.exp(reach)])


def rms_log_error(residuals: Array, groups: Groups | None = None) -> tuple[Array, int]:
    """Standard error of the logarithm of an RMS, by target, and the number of groups it is from.

    It is 0 where all residuals are.
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


def rms_ratio_interval(
    residuals: Array,
    groups: Groups,
    n_new: float,
    n_known: float | None = None,
    coverage: float = 0.9,
    other_error: float = 0.0,
    share_new: float = 1.0,
) -> Array:
    """Interval for the RMS of some groups of residuals, as a multiple of that of other groups.

    Times a forecast it is the interval of what a test of few groups will measure; times what such
    a test has measured, with `n_new` infinite, that of what all groups there are would show.

    Parameters
    ----------
    residuals : ndarray of shape (n, n_targets)
        They say how much groups differ.
    groups : ndarray of shape (n,)
        Groups that are independent of each other; two at least.
    n_new : float
        From how many groups the one RMS is; may be infinite. See `effective_groups`.
    n_known : float, optional
        From how many the other is; by default it is that of the residuals.
    coverage : float
        How often the interval shall hold the ratio.
    other_error : float
        As of `rms_interval`.
    share_new : float
        Share of the residuals of the one RMS that are of new groups; the others are of the known
        groups, from 0 to 1.

    Returns
    -------
    ndarray of shape (2, n_targets)
        Lower and upper end; 1 where all residuals are 0.

    Notes
    -----
    The mean squares of groups count as log-normal, ``m_g = exp(mu + s z_g)`` with `z_g` standard
    normal. Of k groups with the sample variance `v` of ``log m_g``, ``s^2`` is distributed as
    ``v (k - 1) / chi^2(k - 1)`` [1]_; the interval holds the quantiles of
    ``(log mean exp(s z_new) - log mean exp(s z_known)) / 2`` over draws of s and z. Groups that
    differ a lot thus make it wide, and so do few of them, on either side. Single residuals are not
    log-normal, but the mean squares of some are: more than 12 groups are put together at random.

    References
    ----------
    .. [1] A. Gelman et al., "Bayesian data analysis", 3rd edition, CRC Press, 2013, section 3.2.

    Examples
    --------
    >>> residuals = np.random.default_rng(0).normal(size=(130, 1))
    >>> rms_ratio_interval(residuals, np.repeat(np.arange(10), 13), n_new=4).round(1)
    array([[0.8],
           [1.3]])
    """
    variances, n_units, share = _spread_of_units(residuals, groups)
    known = effective_groups(groups) if n_known is None else n_known
    rng = np.random.default_rng(0)
    scales = np.sqrt((n_units - 1) / rng.chisquare(n_units - 1, _N_DRAWS))
    spreads = np.sqrt(variances) * scales[:, None]
    new, old = (_log_means(spreads, n * share, rng) for n in (n_new, known))
    if share_new < 1:
        new = np.logaddexp(new + np.log(max(share_new, 1e-12)), old + np.log1p(-share_new))
    tail = (1 - coverage) / 2
    low, high = np.quantile((new - old) / 2, (tail, 1 - tail), axis=0)
    other = norm.isf(tail) * other_error
    return np.exp([-np.hypot(np.minimum(low, 0), other), np.hypot(np.maximum(high, 0), other)])


def effective_groups(groups: Groups) -> float:
    """How many groups of equal size are worth as much as these, ``(sum n_g)^2 / sum n_g^2``.

    The formula is Kish's (L. Kish, "Survey sampling", Wiley, 1965).

    Examples
    --------
    >>> effective_groups(np.array([0, 0, 1, 1])), effective_groups(np.array([0, 0, 0, 1]))
    (2.0, 1.6)
    """
    _, sizes = np.unique(groups, return_counts=True)
    return float(sizes.sum() ** 2 / np.sum(sizes**2))


def _spread_of_units(residuals: Array, groups: Groups) -> tuple[Array, int, float]:
    """Variance of log mean squares, of how many units, and how many of these a group is worth."""
    _, members = np.unique(groups, return_inverse=True)
    n_groups = int(members.max()) + 1
    n_units = min(n_groups, MOST_UNITS)
    if n_groups > n_units:
        order = np.random.default_rng(0).permutation(n_groups)
        members = order[members] * n_units // n_groups
    sums = np.zeros((n_units, residuals.shape[1]))
    np.add.at(sums, members, residuals**2)
    squares = sums / np.bincount(members)[:, None]
    mean = squares.mean(axis=0)
    shares = np.divide(squares, mean, out=np.ones_like(squares), where=mean > 0)
    logs = np.log(np.maximum(shares, _LEAST_SHARE))
    return logs.var(axis=0, ddof=1), n_units, n_units / n_groups


def _log_means(spreads: Array, n: float, rng: np.random.Generator) -> Array:
    """Logarithms of means of n log-normal numbers, one for every spread."""
    if math.isinf(n):
        return spreads**2 / 2
    drawn = rng.normal(size=(max(round(n), 1), len(spreads), 1))
    return np.asarray(logsumexp(spreads * drawn, axis=0) - np.log(len(drawn)))
