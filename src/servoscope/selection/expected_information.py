"""The mean information that two variables show over all orders of the samples of one of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from servoscope.compiled import compiled
from servoscope.selection.binning import Codes
from servoscope.selection.histogram_sums import n_log_n, n_log_n_table, sum_n_log_n

_NEGLIGIBLE = 1e-17
"""Counts that are less likely than this, as a share of the likeliest, are left out."""


def expected_information(a: Codes, b: Codes, n_bins: int) -> NDArray[np.float64]:
    """Mean mutual information of every two variables over all orders of their samples, [bits].

    Parameters
    ----------
    a, b : ndarrays of shape (n_variables, n_samples), uint8
    n_bins : int

    Returns
    -------
    ndarray of shape (len(a), len(b))
        Exactly 0 for a constant.

    Notes
    -----
    With the histograms of both variables kept, the count of a cell is hypergeometric: of the
    ``n_i`` samples in a bin of one variable, each is among the ``m_j`` in a bin of the other.

    References
    ----------
    N. Vinh, J. Epps and J. Bailey, "Information theoretic measures for clusterings comparison",
    Journal of Machine Learning Research 11, 2010.
    """
    counts_a, counts_b = (
        np.stack([np.bincount(row, minlength=n_bins) for row in c]) for c in (a, b)
    )
    return _expected(counts_a, counts_b, a.shape[1], n_log_n_table(a.shape[1]))


@compiled()
def _expected(
    counts_a: NDArray[np.int64],
    counts_b: NDArray[np.int64],
    n_samples: int,
    table: NDArray[np.float64],
) -> NDArray[np.float64]:
    information = np.empty((len(counts_a), len(counts_b)))
    for i in range(len(counts_a)):
        for j in range(len(counts_b)):
            joint = 0.0
            for n in counts_a[i]:
                for m in counts_b[j]:
                    joint += _expected_n_log_n(n, m, n_samples, table)
            # In this order the terms cancel to exactly 0 when one of the variables is constant.
            total = (joint - sum_n_log_n(counts_b[j], table)) + (
                n_log_n(n_samples, table) - sum_n_log_n(counts_a[i], table)
            )
            information[i, j] = max(total / n_samples, 0.0)
    return information


@compiled()
def _expected_n_log_n(n: int, m: int, n_samples: int, table: NDArray[np.float64]) -> float:
    """Mean of k log2 k, k being how many of n samples are among m of all."""
    mode = (n + 1) * (m + 1) // (n_samples + 2)
    weights, total = 1.0, n_log_n(mode, table)
    weight, k = 1.0, mode
    while weight > _NEGLIGIBLE and k < min(n, m):
        weight *= (n - k) * (m - k) / ((k + 1) * (n_samples - n - m + k + 1))
        k += 1
        weights += weight
        total += weight * n_log_n(k, table)
    weight, k = 1.0, mode
    while weight > _NEGLIGIBLE and k > max(0, n + m - n_samples):
        weight *= k * (n_samples - n - m + k) / ((n - k + 1) * (m - k + 1))
        k -= 1
        weights += weight
        total += weight * n_log_n(k, table)
    return total / weights
