"""Equal-width bins over the observed range."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.compiled import compiled
from servoscope.errors import InvalidInputError
from servoscope.selection.tables import as_table, check_span

MAX_BINS = 256
"""More bins than a byte can number are of no use: the bias of the information, about
``(n_bins - 1)^2 / (2 n_samples ln 2)`` bits, would swamp it for any sensible number of samples."""

Codes = NDArray[np.uint8]


def bin_codes(X: ArrayLike, n_bins: int = 10, name: str = "X") -> Codes:
    """Number of the bin that every value falls in, one row a column of `X`.

    Each column's range is cut into `n_bins` of equal width. A value on an edge belongs to the
    bin on its right, the maximum to the last bin: the rule of `numpy.histogram`. All values of a
    constant column fall in bin 0.

    Parameters
    ----------
    X : array of shape (n_samples, n_columns)
    n_bins : int
        2 to 256.
    name : str
        What error messages call `X`.

    Returns
    -------
    ndarray of shape (n_columns, n_samples), uint8
        A row is contiguous, so that two of them can be counted against each other quickly.

    Raises
    ------
    InvalidInputError
        If `X` is not a table of finite numbers, has no sample, or `n_bins` is out of range.

    Examples
    --------
    >>> bin_codes([[0.0], [0.5], [1.9], [2.0]], n_bins=4)
    array([[0, 1, 3, 3]], dtype=uint8)
    """
    check_n_bins(n_bins)
    values = as_table(X, name)
    low, high = values.min(axis=0), values.max(axis=0)
    check_span(low, high, name)
    return _codes(values, low, high, n_bins)


def check_n_bins(n_bins: int) -> None:
    """Raise InvalidInputError unless `n_bins` is an integer from 2 to `MAX_BINS`."""
    if not isinstance(n_bins, int | np.integer) or not 2 <= n_bins <= MAX_BINS:
        raise InvalidInputError(f"n_bins must be an integer from 2 to {MAX_BINS}, got {n_bins!r}.")


@compiled()
def _codes(
    X: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64], n_bins: int
) -> Codes:
    n_samples, n_columns = X.shape
    edges = np.empty((n_columns, n_bins + 1))
    for j in range(n_columns):
        edges[j] = np.linspace(low[j], high[j], n_bins + 1)
    codes = np.zeros((n_columns, n_samples), np.uint8)
    for i in range(n_samples):
        for j in range(n_columns):
            if high[j] > low[j]:
                x = X[i, j]
                code = min(int((x - low[j]) / (high[j] - low[j]) * n_bins), n_bins - 1)
                # Rounding may have put a value that is next to an edge on its wrong side.
                while code > 0 and x < edges[j, code]:
                    code -= 1
                while code < n_bins - 1 and x >= edges[j, code + 1]:
                    code += 1
                codes[j, i] = code
    return codes
