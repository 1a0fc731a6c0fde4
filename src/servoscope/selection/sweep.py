"""Minimum subsets of features: a threshold on the information, swept."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from servoscope.errors import InvalidInputError

DEFAULT_THRESHOLDS = tuple(i / 20 for i in range(21))
"""Thresholds from 0 to 1 bit."""


@dataclass(frozen=True)
class ThresholdSubset:
    """The features whose information is above each of the given thresholds.

    Parameters
    ----------
    features : tuple of int
        Indices, in the order of the ranking.
    thresholds : tuple of float
        All the swept thresholds that give this subset, ascending, [bits].
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

    Parameters
    ----------
    subsets : sequence of ThresholdSubset
    rms : array of shape (n_subsets,)
        Error of what was trained on each subset; NaN where training failed.

    Returns
    -------
    int

    Raises
    ------
    InvalidInputError
        If there is not one error for each subset, or none of them is a number.

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
