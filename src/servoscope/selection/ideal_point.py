"""The paper's selection: the ideal-point rule, its bias and stability, and minimum subsets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import kendalltau

from servoscope.errors import InvalidInputError
from servoscope.selection.candidates import Candidates, Ranking, rank_greedily
from servoscope.selection.estimators import (
    corrected_mutual_information,
    information_bias,
    mutual_information,
    pairwise_mutual_information,
)


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


def rank_ideal_point_corrected(
    candidates: Candidates, n_features: int, correction: str = "miller_madow"
) -> Ranking:
    """Rank features by the ideal-point rule on corrected information, see `information_bias`.

    The relevance and redundancy of the ranking are the corrected ones.

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
    """How much of the redundancy at each step of a ranking by uncorrected information is bias,
    [bits]. It is of the same sum of pairs as ``ranking.redundancy``. Only ``"miller_madow"`` is
    right for features that are related, as most candidates are.

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


DEFAULT_THRESHOLDS = tuple(i / 20 for i in range(21))
"""Thresholds from 0 to 1 bit."""


@dataclass(frozen=True)
class ThresholdSubset:
    """The features, in the order of the ranking, whose information is above each of the given
    thresholds: all the swept ones, ascending, [bits], that give this subset.
    """

    features: tuple[int, ...]
    thresholds: tuple[float, ...]


def threshold_subsets(
    order: ArrayLike, relevance: ArrayLike, thresholds: ArrayLike = DEFAULT_THRESHOLDS
) -> list[ThresholdSubset]:
    """Distinct subsets of ranked features with more information than a threshold.

    Parameters
    ----------
    order : array of shape (n_ranked,)
        Indices of the ranked features.
    relevance : array of shape (n_ranked,)
        Information about the target of each ranked feature, in the same order, [bits].
    thresholds : array of shape (n_thresholds,)
        [bits].

    Returns
    -------
    list of ThresholdSubset
        From the largest subset to the smallest; without the empty one.

    Raises
    ------
    InvalidInputError
        If `order` and `relevance` differ in length, or a relevance or threshold is not finite.

    Notes
    -----
    Section 5 of Wells and Torras (2001): "subsets of features with MI values above minimum
    threshold values, which were varied between 0 and 1", here strictly above.

    Examples
    --------
    >>> for subset in threshold_subsets([7, 2, 5], [0.9, 0.3, 0.6], [0.0, 0.2, 0.4, 0.8, 1.0]):
    ...     print(subset.features, subset.thresholds)
    (7, 2, 5) (0.0, 0.2)
    (7, 5) (0.4,)
    (7,) (0.8,)
    """
    order, relevance = np.asarray(order), np.asarray(relevance, dtype=float)
    thresholds = np.sort(np.asarray(thresholds, dtype=float))
    if order.ndim != 1 or order.shape != relevance.shape:
        raise InvalidInputError(
            "order and relevance must have one entry for each ranked feature, got the shapes "
            f"{order.shape} and {relevance.shape}."
        )
    if not np.isfinite(relevance).all() or not np.isfinite(thresholds).all():
        raise InvalidInputError(
            "relevance and thresholds must be finite, but hold NaN or infinity."
        )
    found: dict[tuple[int, ...], list[float]] = {}
    for threshold in thresholds.tolist():
        features = tuple(order[relevance > threshold].tolist())
        if features:
            found.setdefault(features, []).append(threshold)
    return [ThresholdSubset(features, tuple(at)) for features, at in found.items()]


def best_subset(subsets: Sequence[ThresholdSubset], rms: ArrayLike) -> int:
    """Position of the subset with the least RMS error; of equals, that with the fewest features.

    The error is NaN where training failed; one of them at least must be a number.

    Examples
    --------
    >>> subsets = threshold_subsets([7, 2, 5], [0.9, 0.3, 0.6], [0.0, 0.4, 0.8])
    >>> best_subset(subsets, [0.1, 0.1, 0.2])
    1
    """
    errors = np.asarray(rms, dtype=float)
    if errors.shape != (len(subsets),):
        raise InvalidInputError(
            f"rms must be {len(subsets)} errors, one a subset, got the shape {errors.shape}."
        )
    trained = np.flatnonzero(~np.isnan(errors)).tolist()
    if not trained:
        raise InvalidInputError("rms must hold at least one number, but all of it is NaN.")
    return min(trained, key=lambda i: (errors[i], len(subsets[i].features)))


DEFAULT_BINS = tuple(range(5, 21))
"""The numbers of bins between which the paper found one and the same order."""


@dataclass(frozen=True, eq=False)
class OrderStability:
    """Orders of selection for several numbers of bins, beside that of a reference number.

    Parameters
    ----------
    n_bins : ndarray of shape (n,)
        The numbers of bins.
    orders : ndarray of shape (n, n_features)
        All features in their order of selection, for each number of bins.
    same_steps : ndarray of shape (n,)
        Number of first steps that select what the reference selects: where the order departs.
    overlap : ndarray of shape (n,)
        Share of the first `n_top` features that the two orders have in common, 0 to 1.
    kendall_tau : ndarray of shape (n,)
        Rank correlation of the two orders of all features, -1 to 1; 1 for a single feature.
    """

    n_bins: NDArray[np.intp]
    orders: NDArray[np.intp]
    same_steps: NDArray[np.intp]
    overlap: NDArray[np.float64]
    kendall_tau: NDArray[np.float64]


def order_stability(
    X: ArrayLike,
    y: ArrayLike,
    n_bins: Sequence[int] = DEFAULT_BINS,
    reference: int = 10,
    n_top: int = 24,
) -> list[OrderStability]:
    """Compare the ideal-point order of features between numbers of bins.

    Parameters
    ----------
    X : array of shape (n_samples, n_features)
    y : array of shape (n_samples,) or (n_samples, n_targets)
    n_bins : sequence of int
    reference : int
        Number of bins that the others are compared with.
    n_top : int
        How many first features the overlap counts.

    Returns
    -------
    list of OrderStability
        One for each target.

    Raises
    ------
    InvalidInputError
        If a value is NaN or infinite, or a number of bins is out of range or none is given.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> X = rng.uniform(size=(1000, 3))
    >>> (stability,) = order_stability(X, X @ [1.0, 0.5, 0.1], n_bins=[8, 10])
    >>> stability.same_steps
    array([3, 3])
    """
    if not len(n_bins):
        raise InvalidInputError("n_bins must name at least one number of bins, got none.")
    targets = np.asarray(y)
    targets = targets[:, None] if targets.ndim == 1 else targets
    expected = _orders(X, targets, reference)
    orders = np.array([_orders(X, targets, n) for n in n_bins])
    return [
        _compare(np.array(n_bins), orders[:, target], expected[target], n_top)
        for target in range(len(expected))
    ]


def _orders(X: ArrayLike, targets: ArrayLike, n_bins: int) -> NDArray[np.intp]:
    relevance = mutual_information(X, targets, n_bins)
    pairwise = pairwise_mutual_information(X, n_bins)
    return np.array([rank_ideal_point(r, pairwise, len(r)).order for r in relevance.T])


def _compare(
    n_bins: NDArray[np.intp], orders: NDArray[np.intp], expected: NDArray[np.intp], n_top: int
) -> OrderStability:
    agrees = orders == expected
    n_top = min(n_top, len(expected))
    return OrderStability(
        n_bins=n_bins,
        orders=orders,
        same_steps=np.logical_and.accumulate(agrees, axis=1).sum(axis=1),
        overlap=np.array([np.isin(o[:n_top], expected[:n_top]).mean() for o in orders]),
        kendall_tau=np.array([_kendall_tau(o, expected) for o in orders]),
    )


def _kendall_tau(order: NDArray[np.intp], expected: NDArray[np.intp]) -> float:
    if len(order) == 1:
        return 1.0
    return float(kendalltau(np.argsort(order), np.argsort(expected)).statistic)
