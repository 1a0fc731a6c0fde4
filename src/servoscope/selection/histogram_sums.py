"""Sums of n log2 n over the cells of histograms: what entropies of counts are made of."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from servoscope.compiled import compiled
from servoscope.selection.binning import Codes

_TABLE_LENGTH = 4096
"""Counts up to this one find their n log n in a table that stays in the cache."""


def n_log_n_table(n_samples: int) -> NDArray[np.float64]:
    """The numbers n log2 n of every count that is likely among `n_samples`."""
    n = np.arange(1, min(n_samples, _TABLE_LENGTH) + 1)
    return np.concatenate([[0.0], n * np.log2(n)])


@compiled()
def n_log_n(n: int, table: NDArray[np.float64]) -> float:
    """One number n log2 n, from the table where it reaches so far."""
    return table[n] if n < len(table) else n * np.log2(n)


@compiled()
def sum_n_log_n(counts: NDArray[np.int32], table: NDArray[np.float64]) -> float:
    """Sum of n log2 n over counts."""
    total = 0.0
    for n in counts:
        total += n_log_n(n, table)
    return total


@compiled()
def joint_counts(a: Codes, b: Codes, n_bins: int) -> NDArray[np.int32]:
    """The joint histogram of two variables."""
    counts = np.zeros((n_bins, n_bins), np.int32)
    for i in range(len(a)):
        counts[a[i], b[i]] += 1
    return counts
