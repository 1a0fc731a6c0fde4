"""The features that a criterion chooses from, and what is known of them."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.errors import InvalidInputError
from servoscope.selection.binning import bin_codes
from servoscope.selection.conditional_information import conditional_information
from servoscope.selection.mutual_information import mutual_information, pairwise_mutual_information
from servoscope.selection.tables import as_samples


class Candidates:
    """Candidate features and one target; what they tell is computed when it is asked for.

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
    Neither of two bits tells of their exclusive or, but the second does once the first is known:

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
