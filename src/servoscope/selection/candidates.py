"""What criteria of selection choose from, what they return, and their greedy loop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from numbers import Integral

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.errors import InvalidInputError
from servoscope.selection.estimators import mutual_information, pairwise_mutual_information
from servoscope.selection.histograms import bin_codes, conditional_information
from servoscope.selection.samples import as_samples


@dataclass(frozen=True, eq=False)
class Ranking:
    """Features in the order in which they were selected.

    Parameters
    ----------
    order : ndarray of shape (n_steps,)
        Index of the feature that was selected at each step.
    candidate_relevance : ndarray of shape (n_features,)
        Information of every feature about the target, [bits].
    candidate_redundancy : ndarray of shape (n_steps, n_features)
        Sum of the information of every candidate about the features selected before the step,
        [bits]; NaN for those that are no candidates any more.
    """

    order: NDArray[np.intp]
    candidate_relevance: NDArray[np.float64]
    candidate_redundancy: NDArray[np.float64]

    @property
    def relevance(self) -> NDArray[np.float64]:
        """Information of the feature selected at each step about the target, [bits]."""
        return self.candidate_relevance[self.order]

    @property
    def redundancy(self) -> NDArray[np.float64]:
        """Redundancy of the feature selected at each step, at that step, [bits]."""
        return self.candidate_redundancy[np.arange(len(self.order)), self.order]


class Candidates:
    """Candidate features and one target; their information is computed when it is asked for.

    Parameters
    ----------
    X : array of shape (n_samples, n_candidates)
    y : array of shape (n_samples,)
    n_bins : int
        Number of equal-width bins over the observed range of each variable.

    Raises
    ------
    InvalidInputError
        If `X` is not a table of finite numbers, or `y` is not one finite number a sample.

    Examples
    --------
    Neither of two bits alone informs of their exclusive or; the second does given the first:

    >>> X = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])
    >>> candidates = Candidates(X, X[:, 0] ^ X[:, 1], n_bins=2)
    >>> candidates.relevance
    array([0., 0.])
    >>> candidates.relevance_given(0)
    array([0., 1.])
    """

    def __init__(self, X: ArrayLike, y: ArrayLike, n_bins: int = 10):
        self.X, targets = as_samples(X, y)
        if targets.shape[1] != 1:
            raise InvalidInputError(f"y must be one target, got the shape {np.shape(y)}.")
        self.y = targets[:, 0]
        self.n_bins = n_bins

    def __len__(self) -> int:
        return self.X.shape[1]

    @cached_property
    def relevance(self) -> NDArray[np.float64]:
        """Information of every candidate about the target, [bits]."""
        return mutual_information(self.X, self.y, self.n_bins)

    @cached_property
    def pairwise(self) -> NDArray[np.float64]:
        """Information of every two candidates about each other, [bits]."""
        return pairwise_mutual_information(self.X, self.n_bins)

    def relevance_given(self, selected: int) -> NDArray[np.float64]:
        """Information of every candidate about the target once one of them is known, [bits]."""
        target = bin_codes(self.y[:, None], self.n_bins, name="y")[0]
        return conditional_information(self._codes, target, self._codes[selected], self.n_bins)[0]

    @cached_property
    def _codes(self) -> NDArray[np.uint8]:
        return bin_codes(self.X, self.n_bins)


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

    All features are ranked if there are fewer than `n_features`; of equal candidates the one of
    lowest index is selected.
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
