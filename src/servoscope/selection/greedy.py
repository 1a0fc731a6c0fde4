"""Selecting one feature after the other, each time that of the greatest score."""

from __future__ import annotations

from collections.abc import Callable
from numbers import Integral

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import InvalidInputError
from servoscope.selection.ranking import Ranking

Scores = Callable[[list[int], NDArray[np.float64]], NDArray[np.float64]]
"""From the features selected so far, in order, and the redundancy of every candidate with them to
the score of every candidate. The redundancy is NaN for those that are selected already; what their
scores are does not matter."""


def rank_greedily(
    relevance: NDArray[np.float64],
    pairwise: NDArray[np.float64],
    n_features: int,
    scores: Scores,
) -> Ranking:
    """Rank features by a score that depends on those selected so far.

    Parameters
    ----------
    relevance : ndarray of shape (n_candidates,)
    pairwise : ndarray of shape (n_candidates, n_candidates)
    n_features : int
        How many features to rank; all of them if there are fewer.
    scores : callable
        Of equal candidates the one of lowest index is selected.

    Returns
    -------
    Ranking

    Raises
    ------
    InvalidInputError
        If `n_features` is not a positive integer.
    """
    if not isinstance(n_features, Integral) or n_features < 1:
        raise InvalidInputError(f"n_features must be 1 or more, got {n_features!r}.")
    n_steps = min(int(n_features), len(relevance))
    selected: list[int] = []
    redundancies = np.empty((n_steps, len(relevance)))
    redundancy = np.zeros(len(relevance))
    for step in range(n_steps):
        redundancies[step] = redundancy
        score = np.where(np.isnan(redundancy), -np.inf, scores(selected, redundancy))
        chosen = int(np.argmax(score))
        selected.append(chosen)
        redundancy = redundancy + pairwise[chosen]
        redundancy[chosen] = np.nan
    return Ranking(np.array(selected, dtype=np.intp), relevance, redundancies)
