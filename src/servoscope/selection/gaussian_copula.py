"""Information of variables that are jointly Gaussian once their margins are."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.selection.ranks import at_most_entropy, normal_scores
from servoscope.selection.tables import as_samples, one_column_each


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
