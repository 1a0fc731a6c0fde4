"""The ideal-point rule: most information about the target, least about what is selected."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.errors import InvalidInputError
from servoscope.selection.greedy import rank_greedily
from servoscope.selection.ranking import Ranking


def rank_ideal_point(relevance: ArrayLike, pairwise: ArrayLike, n_features: int) -> Ranking:
    """Rank features by their distance to the ideal point of the selection plane.

    Parameters
    ----------
    relevance : array of shape (n_candidates,)
        Information of every feature about the target, [bits].
    pairwise : array of shape (n_candidates, n_candidates)
        Information of every two features, [bits].
    n_features : int
        How many features to rank; all of them if there are fewer.

    Returns
    -------
    Ranking

    Raises
    ------
    InvalidInputError
        If the shapes disagree, a value is not finite, or `n_features` is not positive.

    Notes
    -----
    A candidate stands at the point ``(sum_k I(f; f_k), I(f; y))`` of a plane, where ``f_k`` are the
    features selected so far. Each step selects the candidate that is nearest to the ideal point
    ``(0, max I(f; y))``, the lowest index among equals. Section 5 of Wells and Torras (2001)
    speaks of the "minimum" of the sum, the caption of their figure 10 of "zero": zero it is.
    The maximum is over the candidates that remain, since those are what the figure plots.

    References
    ----------
    G. Wells and C. Torras, "Assessing image features for vision-based robot positioning",
    Journal of Intelligent and Robotic Systems 30, 2001.

    G. Zheng and S. Billings, "Radial basis function network configuration using mutual
    information and the orthogonal least squares algorithm", Neural Networks 9(9), 1996.

    Examples
    --------
    The second feature repeats the first, so the third goes before it:

    >>> pairwise = [[3.0, 3.0, 0.1], [3.0, 3.0, 0.1], [0.1, 0.1, 3.0]]
    >>> ranking = rank_ideal_point([1.0, 1.0, 0.4], pairwise, n_features=3)
    >>> ranking.order
    array([0, 2, 1])
    >>> ranking.redundancy
    array([0. , 0.1, 3.1])
    """
    relevance, pairwise = _checked(relevance, pairwise)

    def nearness(_: list[int], redundancy: NDArray[np.float64]) -> NDArray[np.float64]:
        best = relevance[~np.isnan(redundancy)].max()
        return -(redundancy**2 + (best - relevance) ** 2)

    return rank_greedily(relevance, pairwise, n_features, nearness)


def _checked(
    relevance: ArrayLike, pairwise: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    relevance, pairwise = np.asarray(relevance, dtype=float), np.asarray(pairwise, dtype=float)
    n_candidates = relevance.size
    if relevance.shape != (n_candidates,) or pairwise.shape != (n_candidates, n_candidates):
        raise InvalidInputError(
            "relevance and pairwise must have the shapes (n_candidates,) and (n_candidates, "
            f"n_candidates), got {relevance.shape} and {pairwise.shape}."
        )
    if not n_candidates or not np.isfinite(relevance).all() or not np.isfinite(pairwise).all():
        raise InvalidInputError(
            f"relevance and pairwise must be finite and not empty, got {n_candidates} candidates "
            "and perhaps NaN or infinity among them."
        )
    return relevance, pairwise
