"""Greedy conditional mutual information."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from servoscope.selection.candidates import Candidates
from servoscope.selection.conditional_information import conditional_information
from servoscope.selection.equal_frequency import quantile_codes
from servoscope.selection.greedy import rank_greedily
from servoscope.selection.ranking import Ranking

N_COARSE_BINS = 4
"""Bins of equal frequency, of every variable: 4^4 cells for a pair that is known."""


def rank_conditional(
    candidates: Candidates, n_features: int, n_bins: int = N_COARSE_BINS
) -> Ranking:
    """Rank features by what they add once the two features that resemble them most are known.

    Parameters
    ----------
    candidates : Candidates
    n_features : int
        How many features to rank; all of them if there are fewer.
    n_bins : int
        Bins of equal frequency, for the conditional information alone.

    Returns
    -------
    Ranking

    Notes
    -----
    What ought to be greatest is ``I(f; y | f_1, ..., f_k)`` over all the features selected so far,
    but its histogram has ``n_bins^(k + 2)`` cells: no number of images fills them. So a candidate
    is judged by ``I(f; y | f_a, f_b)``, less Miller-Madow's bias, with the two selected features
    that have most information about it, in a few bins of equal frequency. Two features do not
    stand for all: what a candidate repeats of three others together is not seen, nor what it tells
    with a selected feature it does not resemble. And once the target's coarse bin is known, all
    candidates look alike.

    Examples
    --------
    >>> X = np.random.default_rng(0).uniform(size=(1000, 3))
    >>> X[:, 1] = X[:, 0]
    >>> rank_conditional(Candidates(X, X[:, 0] + 0.5 * X[:, 2]), 3).order
    array([0, 2, 1])
    """
    codes = quantile_codes(candidates.X, n_bins)
    target = quantile_codes(candidates.y[:, None], n_bins)[0]

    def score(selected: list[int], redundancy: NDArray[np.float64]) -> NDArray[np.float64]:
        if not selected:
            return candidates.relevance
        scores = np.full(len(codes), -np.inf)
        for candidate in np.flatnonzero(~np.isnan(redundancy)):
            known = _most_alike(candidates.pairwise[candidate], selected)
            pair = codes[known[0]] + n_bins * codes[known[-1]].astype(int)
            information, bias = conditional_information(
                codes[candidate : candidate + 1], target, pair, n_bins
            )
            scores[candidate] = information[0] - bias[0]
        return scores

    return rank_greedily(candidates.relevance, candidates.pairwise, n_features, score)


def _most_alike(information: NDArray[np.float64], selected: list[int]) -> list[int]:
    """The two selected features with most information about a candidate, or the only one."""
    return sorted(selected, key=lambda k: -information[k])[:2]
