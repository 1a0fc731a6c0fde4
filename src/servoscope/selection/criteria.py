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
from servoscope.selection.histograms import conditional_information, quantile_codes
from servoscope.selection.ideal_point import rank_ideal_point, rank_ideal_point_corrected


def rank_mrmr(candidates: Candidates, n_features: int) -> Ranking:
    """Rank features by their relevance less their mean redundancy.

    Parameters
    ----------
    candidates : Candidates
    n_features : int
        How many features to rank; all of them if there are fewer.

    Returns
    -------
    Ranking

    Notes
    -----
    The difference form, called MID: each step selects the greatest
    ``I(f; y) - mean_k I(f; f_k)`` over the features ``f_k`` selected so far.

    References
    ----------
    H. Peng, F. Long and C. Ding, "Feature selection based on mutual information: criteria of
    max-dependency, max-relevance, and min-redundancy", IEEE Transactions on Pattern Analysis and
    Machine Intelligence 27(8), 2005.

    Examples
    --------
    >>> X = np.random.default_rng(0).uniform(size=(1000, 3))
    >>> X[:, 1] = X[:, 0]
    >>> rank_mrmr(Candidates(X, X[:, 0] + 0.5 * X[:, 2]), 3).order
    array([0, 2, 1])
    """
    relevance = candidates.relevance

    def score(selected: list[int], redundancy: NDArray[np.float64]) -> NDArray[np.float64]:
        return relevance - redundancy / max(len(selected), 1)

    return rank_greedily(relevance, candidates.pairwise, n_features, score)


def rank_jmi(candidates: Candidates, n_features: int) -> Ranking:
    """Rank features by their joint information with each of those selected so far.

    Parameters
    ----------
    candidates : Candidates
    n_features : int
        How many features to rank; all of them if there are fewer.

    Returns
    -------
    Ranking

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
    return _rank_given_each(candidates, n_features, np.add, 0.0)


def rank_cmim(candidates: Candidates, n_features: int) -> Ranking:
    """Rank features by what they add to the one selected feature to which they add least.

    Parameters
    ----------
    candidates : Candidates
    n_features : int
        How many features to rank; all of them if there are fewer.

    Returns
    -------
    Ranking

    Notes
    -----
    Each step selects the greatest ``min_k I(f; y | f_k)`` over the features ``f_k`` selected so
    far. Implementations that take ``I(f; y)`` into the minimum, as the original's fast one does,
    miss what features inform of only jointly. It comes from a histogram of three variables,
    whose bias favours features that spread over many bins; fewer bins keep it small.

    References
    ----------
    F. Fleuret, "Fast binary feature selection with conditional mutual information", Journal of
    Machine Learning Research 5, 2004.

    Examples
    --------
    >>> X = np.random.default_rng(0).uniform(size=(1000, 3))
    >>> X[:, 1] = X[:, 0]
    >>> rank_cmim(Candidates(X, X[:, 0] + 0.5 * X[:, 2]), 3).order
    array([0, 2, 1])
    """
    return _rank_given_each(candidates, n_features, np.minimum, np.inf)


def _rank_given_each(
    candidates: Candidates, n_features: int, combine: np.ufunc, start: float
) -> Ranking:
    """Rank by the information given each selected feature by itself, summed or the least of it."""
    combined = np.full(len(candidates), start)

    def score(selected: list[int], _: NDArray[np.float64]) -> NDArray[np.float64]:
        nonlocal combined
        if not selected:
            return candidates.relevance
        combined = combine(combined, candidates.relevance_given(selected[-1]))
        return combined

    return rank_greedily(candidates.relevance, candidates.pairwise, n_features, score)


N_COARSE_BINS = 4
"""Bins of equal frequency, of every variable: 4^4 cells for a pair that is known."""


def rank_conditional(
    candidates: Candidates, n_features: int, n_bins: int = N_COARSE_BINS
) -> Ranking:
    """Rank features by what they add once the two features that resemble them most are known.

    Parameters
    ----------
    candidates : Candidates
    n_features : int
        How many features to rank; all of them if there are fewer.
    n_bins : int
        Bins of equal frequency, for the conditional information alone.

    Returns
    -------
    Ranking

    Notes
    -----
    What ought to be greatest is ``I(f; y | f_1, ..., f_k)`` over all the features selected so far,
    but its histogram has ``n_bins^(k + 2)`` cells: no number of images fills them. So a candidate
    is judged by ``I(f; y | f_a, f_b)``, less Miller-Madow's bias, with the two selected features
    that have most information about it, in a few bins of equal frequency. Two features do not
    stand for all: what a candidate repeats of three others together is not seen, nor what it adds
    with a selected feature it does not resemble. And once the target's coarse bin is known, all
    candidates score alike.

    Examples
    --------
    >>> X = np.random.default_rng(0).uniform(size=(1000, 3))
    >>> X[:, 1] = X[:, 0]
    >>> rank_conditional(Candidates(X, X[:, 0] + 0.5 * X[:, 2]), 3).order
    array([0, 2, 1])
    """
    codes = quantile_codes(candidates.X, n_bins)
    target = quantile_codes(candidates.y[:, None], n_bins)[0]

    def score(selected: list[int], redundancy: NDArray[np.float64]) -> NDArray[np.float64]:
        if not selected:
            return candidates.relevance
        scores = np.full(len(codes), -np.inf)
        for candidate in np.flatnonzero(~np.isnan(redundancy)):
            known = _most_alike(candidates.pairwise[candidate], selected)
            pair = codes[known[0]] + n_bins * codes[known[-1]].astype(int)
            information, bias = conditional_information(
                codes[candidate : candidate + 1], target, pair, n_bins
            )
            scores[candidate] = information[0] - bias[0]
        return scores

    return rank_greedily(candidates.relevance, candidates.pairwise, n_features, score)


def _most_alike(information: NDArray[np.float64], selected: list[int]) -> list[int]:
    """The two selected features with most information about a candidate, or the only one."""
    return sorted(selected, key=lambda k: -information[k])[:2]


Criterion = Callable[[Candidates, int], Ranking]
"""From the candidates and the number of features to rank to their ranking.

A criterion asks `Candidates` for what it needs: information, or the samples `X` and `y` themselves.
"""


def _ideal_point(candidates: Candidates, n_features: int) -> Ranking:
    return rank_ideal_point(candidates.relevance, candidates.pairwise, n_features)


CRITERIA: dict[str, Criterion] = {
    "ideal_point": _ideal_point,
    "ideal_point_corrected": rank_ideal_point_corrected,
    "mrmr": rank_mrmr,
    "jmi": rank_jmi,
    "cmim": rank_cmim,
    "conditional": rank_conditional,
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
        ``"ideal_point_corrected"``, ``"mrmr"``, ``"jmi"``, ``"cmim"``, ``"conditional"``,
        ``"forecast"``), or a function from `Candidates` and a number of features to a `Ranking`.
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
