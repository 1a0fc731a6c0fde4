"""Estimators of mutual information, by name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.errors import InvalidInputError
from servoscope.selection.bias import corrected_mutual_information
from servoscope.selection.equal_frequency import equal_frequency_information
from servoscope.selection.gaussian_copula import gaussian_copula_information
from servoscope.selection.mutual_information import mutual_information
from servoscope.selection.ranks import at_most_entropy, normal_scores
from servoscope.selection.tables import as_samples, one_column_each

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
