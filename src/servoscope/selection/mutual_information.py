"""Mutual information of features and targets from histograms of equal-width bins."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.compiled import compiled
from servoscope.selection.binning import Codes, bin_codes
from servoscope.selection.histogram_sums import (
    joint_counts,
    n_log_n,
    n_log_n_table,
    sum_n_log_n,
)
from servoscope.selection.tables import as_targets, check_as_many, one_column_each


def mutual_information(X: ArrayLike, y: ArrayLike, n_bins: int = 10) -> NDArray[np.float64]:
    """Mutual information of every feature with every target, [bits].

    Parameters
    ----------
    X : array of shape (n_samples, n_features)
    y : array of shape (n_samples,) or (n_samples, n_targets)
    n_bins : int
        Number of equal-width bins over the observed range of each variable, 2 to 256.

    Returns
    -------
    ndarray of shape (n_features,) or, for two-dimensional `y`, (n_features, n_targets)
        Exactly 0 where the feature or the target is constant.

    Raises
    ------
    InvalidInputError
        If a value is NaN or infinite, the numbers of samples differ, or `n_bins` is out of range.

    Notes
    -----
    Equation 19 of Wells and Torras (2001) with relative frequencies for the probabilities. This
    plug-in estimate is biased upwards: two unrelated variables show about
    ``(n_bins - 1)^2 / (2 n_samples ln 2)`` bits, 0.058 for 10 bins and 1000 samples.

    References
    ----------
    G. Wells and C. Torras, "Assessing image features for vision-based robot positioning",
    Journal of Intelligent and Robotic Systems 30, 2001.

    Examples
    --------
    >>> x = np.arange(1000.0)
    >>> mutual_information(np.column_stack([x, -x, np.zeros(1000)]), x).round(3)
    array([3.322, 3.322, 0.   ])
    """
    codes, targets = bin_samples(X, y, n_bins)
    return one_column_each(information_of_codes(codes, targets, n_bins), y)


def pairwise_mutual_information(X: ArrayLike, n_bins: int = 10) -> NDArray[np.float64]:
    """Mutual information of every two features, [bits].

    Parameters
    ----------
    X : array of shape (n_samples, n_features)
    n_bins : int
        Number of equal-width bins over the observed range of each feature, 2 to 256.

    Returns
    -------
    ndarray of shape (n_features, n_features)
        Symmetric; on the diagonal stands the entropy of the binned feature.

    Raises
    ------
    InvalidInputError
        If a value is NaN or infinite, or `n_bins` is out of range.

    Examples
    --------
    >>> pairwise_mutual_information(np.arange(8.0)[:, None] * [1, -1], n_bins=4)
    array([[2., 2.],
           [2., 2.]])
    """
    codes = bin_codes(X, n_bins)
    return _pairwise_information(codes, n_bins, n_log_n_table(codes.shape[1]))


def bin_samples(X: ArrayLike, y: ArrayLike, n_bins: int) -> tuple[Codes, Codes]:
    """Bins of the features and of the targets, one row a variable."""
    codes, target_codes = bin_codes(X, n_bins), bin_codes(as_targets(y), n_bins, name="y")
    check_as_many(codes.shape[1], target_codes.shape[1])
    return codes, target_codes


def information_of_codes(a: Codes, b: Codes, n_bins: int) -> NDArray[np.float64]:
    """Mutual information of every variable of `a` with every variable of `b`, [bits]."""
    return _information(a, b, n_bins, n_log_n_table(a.shape[1]))


@compiled()
def _information(
    a: Codes, b: Codes, n_bins: int, table: NDArray[np.float64]
) -> NDArray[np.float64]:
    sums_a, sums_b = _marginal_sums(a, n_bins, table), _marginal_sums(b, n_bins, table)
    information = np.empty((len(a), len(b)))
    for i in range(len(a)):
        for j in range(len(b)):
            joint = _joint_sum(a[i], b[j], n_bins, table)
            information[i, j] = _bits(joint, sums_a[i], sums_b[j], a.shape[1], table)
    return information


@compiled()
def _pairwise_information(a: Codes, n_bins: int, table: NDArray[np.float64]) -> NDArray[np.float64]:
    sums = _marginal_sums(a, n_bins, table)
    information = np.empty((len(a), len(a)))
    for i in range(len(a)):
        for j in range(i + 1):
            joint = _joint_sum(a[i], a[j], n_bins, table)
            information[i, j] = _bits(joint, sums[i], sums[j], a.shape[1], table)
            information[j, i] = information[i, j]
    return information


@compiled()
def _joint_sum(a: Codes, b: Codes, n_bins: int, table: NDArray[np.float64]) -> float:
    """Sum of n log2 n over the cells of the joint histogram of two variables."""
    return sum_n_log_n(joint_counts(a, b, n_bins).ravel(), table)


@compiled()
def _marginal_sums(a: Codes, n_bins: int, table: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sum of n log2 n over the histogram of each variable."""
    sums = np.empty(len(a))
    for i in range(len(a)):
        counts = np.zeros(n_bins, np.int32)
        for code in a[i]:
            counts[code] += 1
        sums[i] = sum_n_log_n(counts, table)
    return sums


@compiled()
def _bits(
    joint: float, sum_a: float, sum_b: float, n_samples: int, table: NDArray[np.float64]
) -> float:
    # In this order the terms cancel to exactly 0 when one of the variables is constant.
    total = (joint - sum_b) + (n_log_n(n_samples, table) - sum_a)
    return max(total / n_samples, 0.0)
