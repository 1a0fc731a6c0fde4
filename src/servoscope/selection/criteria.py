"""Criteria of selection by name, and the scikit-learn selector that takes them."""

from __future__ import annotations

from collections.abc import Callable
from numbers import Integral

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator
from sklearn.feature_selection import SelectorMixin
from sklearn.utils import Tags
from sklearn.utils.validation import check_is_fitted, validate_data

from servoscope.arrays import check_unmasked
from servoscope.errors import InvalidInputError
from servoscope.selection.candidates import Candidates, Ranking, rank_greedily
from servoscope.selection.forward import rank_forward
from servoscope.selection.ideal_point import rank_ideal_point, rank_ideal_point_corrected


def rank_jmi(candidates: Candidates, n_features: int) -> Ranking:
    """Rank features by their joint information with each of those selected so far.

    Notes
    -----
    Each step selects the greatest ``sum_k I(f, f_k; y)`` over the features ``f_k`` selected so
    far. As ``I(f, f_k; y) = I(f_k; y) + I(f; y | f_k)`` and the first term is the same for all
    candidates, the second is summed. It comes from a histogram of three variables, whose bias
    favours features that spread over many bins; fewer bins keep it small.

    References
    ----------
    H. Yang and J. Moody, "Data visualization and feature selection: new algorithms for
    nongaussian data", Advances in Neural Information Processing Systems 12, 1999.

    Examples
    --------
    The first two bits together give their exclusive or, the first alone a little of it:

    >>> X = np.random.default_rng(0).integers(0, 2, size=(1000, 5))
    >>> y = X[:, 0] ^ X[:, 1]
    >>> X[:100, 0] = y[:100]
    >>> rank_jmi(Candidates(X, y, n_bins=2), 2).order
    array([0, 1])
    """
    joint = np.zeros(len(candidates))

    def score(selected: list[int], _: NDArray[np.float64]) -> NDArray[np.float64]:
        nonlocal joint
        if not selected:
            return candidates.relevance
        joint = joint + candidates.relevance_given(selected[-1])
        return joint

    return rank_greedily(candidates.relevance, candidates.pairwise, n_features, score)


Criterion = Callable[[Candidates, int], Ranking]
"""From the candidates and the number of features to rank to their ranking.

A criterion asks `Candidates` for what it needs: information, or the samples `X` and `y` themselves.
"""


def _ideal_point(candidates: Candidates, n_features: int) -> Ranking:
    return rank_ideal_point(candidates.relevance, candidates.pairwise, n_features)


CRITERIA: dict[str, Criterion] = {
    "ideal_point": _ideal_point,
    "ideal_point_corrected": rank_ideal_point_corrected,
    "jmi": rank_jmi,
    "forecast": rank_forward,
}
"""What `MutualInfoSelector` takes by name."""


class MutualInfoSelector(SelectorMixin, BaseEstimator):
    """Select features of much information about one target and little about each other.

    Parameters
    ----------
    n_features : int
        How many features to select; all of them if there are fewer.
    criterion : str or callable
        The rule that selects the next feature, by its name in `CRITERIA` (``"ideal_point"``,
        ``"ideal_point_corrected"``, ``"jmi"``, ``"forecast"``), or a function from `Candidates` and
        a number of features to a `Ranking`.
    n_bins : int
        Number of equal-width bins over the observed range of each variable, 2 to 256.

    Attributes
    ----------
    ranking_ : ndarray of shape (n_selected,)
        Indices of the selected features, in the order of selection.
    relevance_ : ndarray of shape (n_selected,)
        Information about the target of the feature selected at each step, [bits].
    redundancy_ : ndarray of shape (n_selected,)
        Sum of the information, about the features selected before it, of the feature selected
        at each step, [bits].
    mutual_information_ : ndarray of shape (n_features_in_,)
        Information of every feature about the target, [bits]; like the redundancy, as the
        criterion takes it.
    candidate_redundancy_ : ndarray of shape (n_selected, n_features_in_)
        Redundancy of every candidate at each step, [bits]; NaN once a feature is selected.
        With `mutual_information_` these are the points of the selection plane.

    Notes
    -----
    As with every scikit-learn selector, `transform` keeps the selected columns in their original
    order. ``X[:, selector.ranking_]`` has them in the order of selection.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> X = rng.uniform(size=(1000, 3))
    >>> X[:, 1] = X[:, 0]
    >>> selector = MutualInfoSelector(n_features=2).fit(X, X[:, 0] + 0.5 * X[:, 2])
    >>> selector.ranking_
    array([0, 2])
    >>> selector.get_feature_names_out()
    array(['x0', 'x2'], dtype=object)
    """

    def __init__(
        self, n_features: int = 24, criterion: str | Criterion = "ideal_point", n_bins: int = 10
    ):
        self.n_features = n_features
        self.criterion = criterion
        self.n_bins = n_bins

    def fit(self, X: ArrayLike, y: ArrayLike) -> MutualInfoSelector:
        """Rank the features.

        Parameters
        ----------
        X : array of shape (n_samples, n_features)
        y : array of shape (n_samples,)
            One target; rank the features for each dof by itself.

        Returns
        -------
        MutualInfoSelector
            Itself.

        Raises
        ------
        InvalidInputError
            If a parameter is out of range, or values of `X` are masked or not finite.
        ValueError
            If `X` is no table, or `y` is not one finite number a sample.
        """
        criterion = self._criterion()
        if not isinstance(self.n_features, Integral) or self.n_features < 1:
            raise InvalidInputError(
                f"n_features must be an integer of 1 or more, got {self.n_features!r}."
            )
        check_unmasked(X, "X")
        check_unmasked(y, "y")
        X, y = validate_data(self, X, y, dtype=np.float64, y_numeric=True, ensure_all_finite=False)
        ranking = criterion(Candidates(X, y, self.n_bins), int(self.n_features))
        self.ranking_: NDArray[np.intp] = ranking.order
        self.relevance_ = ranking.relevance
        self.redundancy_ = ranking.redundancy
        self.mutual_information_ = ranking.candidate_relevance
        self.candidate_redundancy_ = ranking.candidate_redundancy
        return self

    def _criterion(self) -> Criterion:
        if callable(self.criterion):
            return self.criterion
        if self.criterion not in CRITERIA:
            raise InvalidInputError(
                f"criterion must be one of {', '.join(CRITERIA)}, got {self.criterion!r}."
            )
        return CRITERIA[self.criterion]

    def _get_support_mask(self) -> NDArray[np.bool_]:
        check_is_fitted(self)
        return np.isin(np.arange(self.n_features_in_), self.ranking_)

    def __sklearn_tags__(self) -> Tags:
        tags = super().__sklearn_tags__()
        tags.target_tags.required = True
        return tags
