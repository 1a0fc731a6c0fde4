"""Information that features add about a target to what a condition tells already."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from servoscope.compiled import compiled
from servoscope.selection.binning import Codes
from servoscope.selection.histogram_sums import n_log_n, n_log_n_table, sum_n_log_n


def conditional_information(
    features: Codes, target: Codes, condition: NDArray[np.integer], n_bins: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Information of every feature about the target given the condition, and its bias, [bits].

    Parameters
    ----------
    features : ndarray of shape (n_features, n_samples), uint8
    target : ndarray of shape (n_samples,), uint8
    condition : ndarray of shape (n_samples,) of int
        Samples of equal number are under the same condition.
    n_bins : int
        Of the features and of the target.

    Returns
    -------
    information : ndarray of shape (n_features,)
        ``I(f; y | z)`` from relative frequencies, at least 0.
    bias : ndarray of shape (n_features,)
        Miller-Madow's estimate of how much of that is chance. There are as many cells as
        conditions times bins times bins, and few samples for each: it may be most of it.
    """
    order = np.argsort(condition, kind="stable")
    changes = np.flatnonzero(np.diff(condition[order])) + 1
    groups = np.stack([np.append(0, changes), np.append(changes, len(order))], axis=1)
    n_samples = len(order)
    sums, excess = _conditional_sums(
        features, target, order, groups, n_bins, n_log_n_table(n_samples)
    )
    return np.maximum(sums / n_samples, 0.0), excess / (2 * n_samples * np.log(2))


@compiled()
def _conditional_sums(
    features: Codes,
    target: Codes,
    order: NDArray[np.intp],
    groups: NDArray[np.intp],
    n_bins: int,
    table: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    sums, excess = np.zeros(len(features)), np.zeros(len(features), np.int64)
    counts = np.empty((n_bins, n_bins), np.int32)
    counts_f, counts_y = np.empty(n_bins, np.int32), np.empty(n_bins, np.int32)
    for i in range(len(features)):
        for start, end in groups:
            counts[:], counts_f[:], counts_y[:] = 0, 0, 0
            for k in order[start:end]:
                f, y = features[i, k], target[k]
                counts[f, y] += 1
                counts_f[f] += 1
                counts_y[y] += 1
            # In this order the terms cancel to exactly 0 where feature or target is constant.
            sums[i] += (sum_n_log_n(counts.ravel(), table) - sum_n_log_n(counts_y, table)) + (
                n_log_n(end - start, table) - sum_n_log_n(counts_f, table)
            )
            excess[i] += _n_occupied(counts.ravel()) + 1
            excess[i] -= _n_occupied(counts_f) + _n_occupied(counts_y)
    return sums, excess


@compiled()
def _n_occupied(counts: NDArray[np.int32]) -> int:
    n = 0
    for count in counts:
        n += count > 0
    return n
