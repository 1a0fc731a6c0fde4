"""The ideal-point rule without what chance adds to relevance and redundancy."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.selection.bias import corrected_mutual_information, information_bias
from servoscope.selection.candidates import Candidates
from servoscope.selection.ideal_point import rank_ideal_point
from servoscope.selection.ranking import Ranking


def rank_ideal_point_corrected(
    candidates: Candidates, n_features: int, correction: str = "miller_madow"
) -> Ranking:
    """Rank features by the ideal-point rule on corrected information.

    Parameters
    ----------
    candidates : Candidates
    n_features : int
        How many features to rank; all of them if there are fewer.
    correction : {"miller_madow", "chi_square", "permutation"}
        See `information_bias`.

    Returns
    -------
    Ranking
        Its relevance and redundancy are the corrected ones.

    Raises
    ------
    InvalidInputError
        If the correction is unknown, or `n_features` is not positive.

    Notes
    -----
    `rank_ideal_point` sums the information of a candidate with every feature selected so far, and
    with it one bias a feature: after 10 steps, 10 bins and 1000 samples, 0.5 bits. Here every
    piece of information is corrected and set to 0 where that makes it negative, before anything is
    summed. What is left of chance then is its spread, not its mean.

    Examples
    --------
    >>> X = np.random.default_rng(0).uniform(size=(1000, 3))
    >>> candidates = Candidates(X, X @ [1.0, 0.8, 0.6])
    >>> ranking = rank_ideal_point_corrected(candidates, 3)
    >>> ranking.order, ranking.redundancy.round(2)
    (array([0, 1, 2]), array([0., 0., 0.]))
    """
    X, y, n_bins = candidates.X, candidates.y, candidates.n_bins
    relevance = corrected_mutual_information(X, y, n_bins, correction)
    pairwise = corrected_mutual_information(X, X, n_bins, correction)
    return rank_ideal_point(np.maximum(relevance, 0.0), np.maximum(pairwise, 0.0), n_features)


def redundancy_bias(
    X: ArrayLike, ranking: Ranking, n_bins: int = 10, correction: str = "miller_madow"
) -> NDArray[np.float64]:
    """How much of the redundancy at each step of a ranking is bias, [bits].

    Parameters
    ----------
    X : array of shape (n_samples, n_features)
        What was ranked.
    ranking : Ranking
        By uncorrected information.
    n_bins : int
        With which it was ranked.
    correction : {"miller_madow", "chi_square", "permutation"}
        See `information_bias`. Only the first is right for features that are related, as most
        candidates are.

    Returns
    -------
    ndarray of shape (n_steps,)
        Of the same sum of pairs as ``ranking.redundancy``; 0 at the first step.

    Raises
    ------
    InvalidInputError
        If `X` has not the columns that were ranked, or the correction is unknown.

    Examples
    --------
    >>> X = np.random.default_rng(0).uniform(size=(1000, 3))
    >>> candidates = Candidates(X, X @ [1.0, 0.8, 0.6])
    >>> ranking = rank_ideal_point(candidates.relevance, candidates.pairwise, 3)
    >>> ranking.redundancy.round(2), redundancy_bias(X, ranking).round(2)
    (array([0.  , 0.06, 0.11]), array([0.  , 0.06, 0.12]))
    """
    selected = np.asarray(X)[:, ranking.order]
    bias = information_bias(selected, selected, n_bins, correction)
    return np.tril(bias, -1).sum(axis=1)
