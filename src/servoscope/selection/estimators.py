"""Estimators of mutual information, by name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtri
from scipy.stats import rankdata

from servoscope.errors import InvalidInputError
from servoscope.selection.histograms import at_most_entropy, information_of_codes, quantile_codes
from servoscope.selection.information import corrected_mutual_information, mutual_information
from servoscope.selection.samples import as_samples, one_column_each

Array = NDArray[np.float64]


def normal_scores(table: Array) -> Array:
    """Columns as normal as their ties allow, of zero mean; zero for a constant.

    Parameters
    ----------
    table : ndarray of shape (n_samples, n_columns)

    Returns
    -------
    ndarray of shape (n_samples, n_columns)
        The quantiles of the normal distribution at ``rank / (n_samples + 1)``, equal values
        sharing their mean rank.

    Examples
    --------
    >>> normal_scores(np.array([[1e10], [1e200], [-5.0]]))[:, 0].round(2).tolist()
    [0.0, 0.67, -0.67]
    """
    scores = ndtri(rankdata(table, axis=0) / (len(table) + 1))
    scores -= scores.mean(axis=0)
    return np.where(np.abs(scores).max(axis=0) > 1e-12, scores, 0.0)


def equal_frequency_information(
    X: ArrayLike, y: ArrayLike, n_bins: int = 10
) -> NDArray[np.float64]:
    """Mutual information of every feature with every target from bins of equal frequency, [bits].

    It does not change when a variable is replaced by a growing function of it. Its bias is that
    of `mutual_information`.

    Parameters
    ----------
    X : array of shape (n_samples, n_features)
    y : array of shape (n_samples,) or (n_samples, n_targets)
    n_bins : int
        2 to 256.

    Returns
    -------
    ndarray of shape (n_features,) or (n_features, n_targets)

    Raises
    ------
    InvalidInputError
        If the samples do not fit, or `n_bins` is out of range.

    Examples
    --------
    >>> x = np.arange(1000.0)
    >>> equal_frequency_information(x[:, None], np.exp(x / 100)).round(3)
    array([3.322])
    """
    codes, targets = (quantile_codes(table, n_bins) for table in as_samples(X, y))
    return one_column_each(information_of_codes(codes, targets, n_bins)[0], y)


def gaussian_copula_information(X: ArrayLike, y: ArrayLike) -> NDArray[np.float64]:
    """Mutual information of every feature with every target under a Gaussian copula, [bits].

    It sees what rises or falls together, not a symmetric dip or a circle. It does not change when
    a variable is replaced by a growing or falling function of it, and has the least spread and
    bias of all the estimates, about ``1 / (2 n ln 2)`` bits.

    Parameters
    ----------
    X : array of shape (n_samples, n_features)
    y : array of shape (n_samples,) or (n_samples, n_targets)

    Returns
    -------
    ndarray of shape (n_features,) or (n_features, n_targets)
        0 for constants, and never more than the entropy of a variable with equal values. Without
        any, 26 where one variable is a growing or falling function of the other, for which the
        information is infinite.

    Raises
    ------
    InvalidInputError
        If the samples do not fit.

    Notes
    -----
    ``-log2(1 - r^2) / 2``, r being the correlation of the normal scores of the ranks. A lower
    bound of the information if the margins, but not the joint distribution, can be made Gaussian.

    References
    ----------
    R. Ince et al., "A statistical framework for neuroimaging data analysis based on mutual
    information estimated via a Gaussian copula", Human Brain Mapping 38(3), 2017.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> x, noise = rng.normal(size=(2, 1000))
    >>> gaussian_copula_information(x[:, None], np.exp(x + noise)).round(1)
    array([0.5])
    """
    features, targets = as_samples(X, y)
    r = np.clip(_unit(normal_scores(features)).T @ _unit(normal_scores(targets)), -1.0, 1.0)
    information = -0.5 * np.log2(np.maximum(1.0 - r**2, np.finfo(float).eps))
    return one_column_each(at_most_entropy(information, features, targets), y)


def _unit(scores: NDArray[np.float64]) -> NDArray[np.float64]:
    """Columns of unit length; zero stays zero."""
    length = np.linalg.norm(scores, axis=0)
    return scores / np.where(length > 0, length, np.inf)


Estimator = Callable[..., NDArray[np.float64]]
"""From X, y and options to the information of every feature about every target, [bits]."""


def ksg_information(
    X: ArrayLike, y: ArrayLike, n_neighbors: int = 3, random_state: int = 0
) -> NDArray[np.float64]:
    """Mutual information of every feature with every target from nearest neighbours, [bits].

    Parameters
    ----------
    X : array of shape (n_samples, n_features)
    y : array of shape (n_samples,) or (n_samples, n_targets)
    n_neighbors : int
        1 to n_samples - 1; more have less spread and more bias.
    random_state : int
        Draws the tiny noise that separates equal values.

    Returns
    -------
    ndarray of shape (n_features,) or (n_features, n_targets)
        At least 0, and never more than the entropy of a variable with equal values.

    Raises
    ------
    InvalidInputError
        If the samples do not fit, or there are too few for so many neighbours.

    Notes
    -----
    scikit-learn's `mutual_info_regression`, of the normal scores of the ranks: growing functions
    of a variable, its offset and scale among them, change nothing.

    References
    ----------
    A. Kraskov, H. Stögbauer and P. Grassberger, "Estimating mutual information", Physical Review
    E 69, 2004.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> x, noise = rng.normal(size=(2, 1000))
    >>> ksg_information(x[:, None], x + noise).round(1)
    array([0.5])
    """
    from sklearn.feature_selection import mutual_info_regression

    features, targets = as_samples(X, y)
    if not 1 <= n_neighbors < len(features):
        raise InvalidInputError(
            f"n_neighbors must be from 1 to less than the {len(features)} samples, "
            f"got {n_neighbors!r}."
        )
    scores = normal_scores(features)
    nats = [
        mutual_info_regression(scores, t, n_neighbors=n_neighbors, random_state=random_state)
        for t in normal_scores(targets).T
    ]
    information = at_most_entropy(np.stack(nats, axis=1) / np.log(2), features, targets)
    return one_column_each(information, y)


ESTIMATORS: dict[str, Estimator] = {
    "histogram": mutual_information,
    "corrected_histogram": corrected_mutual_information,
    "equal_frequency": equal_frequency_information,
    "ksg": ksg_information,
    "gaussian_copula": gaussian_copula_information,
}
"""All give [bits] for X of shape (n_samples, n_features) and one or several targets."""


def estimate_information(
    X: ArrayLike, y: ArrayLike, estimator: str = "histogram", **options: Any
) -> NDArray[np.float64]:
    """Mutual information of every feature with every target by the named estimator, [bits].

    Parameters
    ----------
    X : array of shape (n_samples, n_features)
    y : array of shape (n_samples,) or (n_samples, n_targets)
    estimator : {"histogram", "corrected_histogram", "equal_frequency", "ksg", "gaussian_copula"}
    **options
        Of the estimator: ``n_bins`` for the histograms, ``correction`` for the corrected one,
        ``n_neighbors`` and ``random_state`` for ``"ksg"``.

    Returns
    -------
    ndarray of shape (n_features,) or (n_features, n_targets)

    Raises
    ------
    InvalidInputError
        If the estimator is unknown, or the samples or options do not fit it.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> x, noise = rng.normal(size=(2, 1000))  # 0.5 bits
    >>> for name in ESTIMATORS:
    ...     print(f"{name:20}{estimate_information(x[:, None], x + noise, name)[0]:.2f}")
    histogram           0.46
    corrected_histogram 0.44
    equal_frequency     0.49
    ksg                 0.51
    gaussian_copula     0.50
    """
    if estimator not in ESTIMATORS:
        raise InvalidInputError(
            f"estimator must be one of {', '.join(ESTIMATORS)}, got {estimator!r}."
        )
    return ESTIMATORS[estimator](X, y, **options)
