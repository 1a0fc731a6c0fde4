"""How the order of selected features depends on the number of bins."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import kendalltau

from servoscope.errors import InvalidInputError
from servoscope.selection.ideal_point import rank_ideal_point
from servoscope.selection.mutual_information import (
    mutual_information,
    pairwise_mutual_information,
)

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
