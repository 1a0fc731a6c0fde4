"""Joint mutual information."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from servoscope.selection.candidates import Candidates
from servoscope.selection.greedy import rank_greedily
from servoscope.selection.ranking import Ranking


def rank_jmi(candidates: Candidates, n_features: int) -> Ranking:
    """Rank features by what they tell together with each of those selected so far.

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
    Each step selects the greatest ``sum_k I(f, f_k; y)`` over the features ``f_k`` selected so
    far. As ``I(f, f_k; y) = I(f_k; y) + I(f; y | f_k)`` and the first term is the same for all
    candidates, the second is summed. It comes from a histogram of three variables, whose bias
    favours features that spread over many bins; fewer bins keep it small.

    References
    ----------
    H. Yang and J. Moody, "Data visualization and feature selection: new algorithms for
    nongaussian data", Advances in Neural Information Processing Systems 12, 1999.

    Examples
    --------
    Together the first two bits tell their exclusive or, the first alone a little, others nothing:

    >>> X = np.random.default_rng(0).integers(0, 2, size=(1000, 5))
    >>> y = X[:, 0] ^ X[:, 1]
    >>> X[:100, 0] = y[:100]
    >>> rank_jmi(Candidates(X, y, n_bins=2), 2).order
    array([0, 1])
    """
    relevance = candidates.relevance
    added = np.zeros(len(candidates))

    def score(selected: list[int], _: NDArray[np.float64]) -> NDArray[np.float64]:
        nonlocal added
        if not selected:
            return relevance
        added = added + candidates.relevance_given(selected[-1])
        return added

    return rank_greedily(relevance, candidates.pairwise, n_features, score)
