"""What a selection criterion returns: the features in order, and why each one was chosen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


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
