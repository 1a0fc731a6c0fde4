"""What growing functions of a variable leave as it is: its ranks, and which values are equal."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri
from scipy.stats import rankdata

Array = NDArray[np.float64]


def normal_scores(table: Array) -> Array:
    """Columns as normal as their ties allow, of zero mean; zero for a constant.

    Parameters
    ----------
    table : ndarray of shape (n_samples, n_columns)

    Returns
    -------
    ndarray of shape (n_samples, n_columns)
        The quantiles of the normal distribution at ``rank / (n_samples + 1)``, equal values
        sharing their mean rank.

    Examples
    --------
    >>> normal_scores(np.array([[1e10], [1e200], [-5.0]]))[:, 0].round(2).tolist()
    [0.0, 0.67, -0.67]
    """
    scores = ndtri(rankdata(table, axis=0) / (len(table) + 1))
    scores -= scores.mean(axis=0)
    return np.where(np.abs(scores).max(axis=0) > 1e-12, scores, 0.0)


def entropy_of_values(table: NDArray) -> Array:
    """Entropy of each column's distinct values, from their relative frequencies, [bits].

    No information about a discrete variable is larger. It is infinite where no two values are
    equal: such a variable counts as continuous.

    Examples
    --------
    >>> entropy_of_values(np.array([[0, 1], [0, 2], [1, 3], [1, 4]]))
    array([ 1., inf])
    """
    return np.array([_entropy(np.unique(column, return_counts=True)[1]) for column in table.T])


def at_most_entropy(information: Array, X: NDArray, Y: NDArray) -> Array:
    """Information of every column of X about every one of Y, at most the entropy of either."""
    limit = np.minimum.outer(entropy_of_values(X), entropy_of_values(Y))
    return np.minimum(information, limit)


def _entropy(counts: NDArray[np.intp]) -> float:
    n = counts.sum()
    # In this order the entropy of a constant is exactly 0.
    return float(counts @ (np.log2(n) - np.log2(counts)) / n) if len(counts) < n else np.inf
