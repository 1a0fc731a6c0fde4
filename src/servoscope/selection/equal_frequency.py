"""Bins that hold equal numbers of samples, and the information they show."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import rankdata

from servoscope.selection.binning import Codes, check_n_bins
from servoscope.selection.mutual_information import information_of_codes
from servoscope.selection.tables import as_samples, one_column_each


def quantile_codes(X: NDArray[np.float64], n_bins: int = 10) -> Codes:
    """Number of the bin of equal frequency that every value falls in, one row a column of `X`.

    Equal values fall in the same bin, so that bins of a column with ties differ in number.

    Parameters
    ----------
    X : ndarray of shape (n_samples, n_columns)
    n_bins : int
        2 to 256.

    Returns
    -------
    ndarray of shape (n_columns, n_samples), uint8

    Raises
    ------
    InvalidInputError
        If `n_bins` is out of range.

    Examples
    --------
    >>> quantile_codes(np.array([[1.0], [2.0], [4.0], [800.0]]), n_bins=2)
    array([[0, 0, 1, 1]], dtype=uint8)
    """
    check_n_bins(n_bins)
    share = (rankdata(X, axis=0) - 0.5) / len(X)
    return np.ascontiguousarray((share * n_bins).astype(np.uint8).T)


def equal_frequency_information(
    X: ArrayLike, y: ArrayLike, n_bins: int = 10
) -> NDArray[np.float64]:
    """Mutual information of every feature with every target from bins of equal frequency, [bits].

    It does not change when a variable is replaced by a growing function of it. Its bias is that
    of `mutual_information`.

    Parameters
    ----------
    X : array of shape (n_samples, n_features)
    y : array of shape (n_samples,) or (n_samples, n_targets)
    n_bins : int
        2 to 256.

    Returns
    -------
    ndarray of shape (n_features,) or (n_features, n_targets)

    Raises
    ------
    InvalidInputError
        If the samples do not fit, or `n_bins` is out of range.

    Examples
    --------
    >>> x = np.arange(1000.0)
    >>> equal_frequency_information(x[:, None], np.exp(x / 100)).round(3)
    array([3.322])
    """
    codes, targets = (quantile_codes(table, n_bins) for table in as_samples(X, y))
    return one_column_each(information_of_codes(codes, targets, n_bins), y)
