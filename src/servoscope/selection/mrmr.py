"""Minimum redundancy, maximum relevance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from servoscope.selection.candidates import Candidates
from servoscope.selection.greedy import rank_greedily
from servoscope.selection.ranking import Ranking


def rank_mrmr(candidates: Candidates, n_features: int) -> Ranking:
    """Rank features by their relevance less their mean redundancy.

    Parameters
    ----------
    candidates : Candidates
    n_features : int
        How many features to rank; all of them if there are fewer.

    Returns
    -------
    Ranking

    Notes
    -----
    The difference form, called MID: each step selects the greatest
    ``I(f; y) - mean_k I(f; f_k)`` over the features ``f_k`` selected so far.

    References
    ----------
    H. Peng, F. Long and C. Ding, "Feature selection based on mutual information: criteria of
    max-dependency, max-relevance, and min-redundancy", IEEE Transactions on Pattern Analysis and
    Machine Intelligence 27(8), 2005.

    Examples
    --------
    >>> X = np.random.default_rng(0).uniform(size=(1000, 3))
    >>> X[:, 1] = X[:, 0]
    >>> rank_mrmr(Candidates(X, X[:, 0] + 0.5 * X[:, 2]), 3).order
    array([0, 2, 1])
    """
    relevance = candidates.relevance

    def score(selected: list[int], redundancy: NDArray[np.float64]) -> NDArray[np.float64]:
        return relevance - redundancy / max(len(selected), 1)

    return rank_greedily(relevance, candidates.pairwise, n_features, score)
