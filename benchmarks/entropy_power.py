"""The RMS errors that mutual information alone allows: entropy power."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import eigh
from scipy.special import ndtri
from scipy.stats import differential_entropy, rankdata

from servoscope.processes import one_blas_thread
from servoscope.selection import corrected_mutual_information
from servoscope.selection.samples import as_samples

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class EntropyPower:
    """RMS errors that information allows, in the unit of each target.

    Both would be lower bounds if the information were known. It is estimated, and mostly too low:
    on images, trained regressors came below `single` in 87 % of all cases, down to a twelfth of
    it, and below `joint` in 78 %, down to an eighth. In a sequence, whose images resemble their
    neighbours, it is too high instead: both came out at less than half of what other blocks of it
    let reach. So these are figures to compare, not limits.

    Parameters
    ----------
    single : ndarray of shape (n_targets,)
        From the most informative single feature, by a histogram of 10 bins, which cannot show more
        than 3.3 bits. Pessimistic wherever several features inform jointly, which is the rule.
    joint : ndarray of shape (n_targets,)
        From all features at once, taken for jointly Gaussian once their margins are. Exact for
        linear Gaussian data; pessimistic where the target bends with the features or is their
        product; optimistic only by chance, with hardly more samples than features.
    """

    single: Array
    joint: Array


def entropy_power(X: ArrayLike, Y: ArrayLike, n_bins: int = 10) -> EntropyPower:
    """The RMS errors that mutual information alone allows.

    Parameters
    ----------
    X : array of shape (n_samples, n_features)
    Y : array of shape (n_samples, n_targets) or (n_samples,)
    n_bins : int
        Of the histogram for the best single feature.

    Returns
    -------
    EntropyPower
        0 for a target that never changes, or takes few distinct values.

    Raises
    ------
    InvalidInputError
        If the samples do not fit.

    Notes
    -----
    An estimate of y from features f has the mean square error ``E[e^2] >= 2^(2 h(y|f)) /
    (2 pi e)`` at least, with equality where e is normal [1]_, and ``h(y|f) = h(y) - I(y; f)``.

    References
    ----------
    .. [1] T. Cover and J. Thomas, "Elements of information theory", 2nd ed., Wiley, 2006,
       theorem 8.6.6.

    """
    features, targets = as_samples(X, Y)
    single = corrected_mutual_information(features, targets, n_bins).max(axis=0)
    spread = np.std(targets, axis=0)
    moves = spread > 1e-12 * np.abs(targets.mean(axis=0))
    entropy = np.full(len(spread), -np.inf)
    with np.errstate(divide="ignore"):  # equal values have an entropy of minus infinity
        entropy[moves] = differential_entropy(targets[:, moves], base=2, axis=0)
    return EntropyPower(
        single=_error_allowed(entropy - np.maximum(single, 0.0)),
        joint=_error_allowed(entropy - joint_information(features, targets)),
    )


def normal_scores(table: Array) -> Array:
    """Quantiles of the normal distribution at the ranks of each column, zero for a constant."""
    scores = ndtri(rankdata(table, axis=0) / (len(table) + 1))
    scores -= scores.mean(axis=0)
    return np.where(np.abs(scores).max(axis=0) > 1e-12, scores, 0.0)


def joint_information(X: Array, Y: Array) -> Array:
    """Information of all features together about each target under a Gaussian copula, [bits].

    Parameters
    ----------
    X : ndarray of shape (n_samples, n_features)
    Y : ndarray of shape (n_samples, n_targets)

    Returns
    -------
    ndarray of shape (n_targets,)
        At least 0; 0 as well where there are no more samples than features.

    Notes
    -----
    ``-log2(1 - R^2) / 2``, R being the multiple correlation of the normal scores, adjusted for the
    number of features.
    """
    scores, target_scores = normal_scores(X), normal_scores(Y)
    is_wide = scores.shape[1] > len(scores)
    with one_blas_thread():
        squares, axes = eigh(scores @ scores.T if is_wide else scores.T @ scores)
    kept = squares > 1e-12 * max(squares[-1], 1.0)
    basis = axes[:, kept] if is_wide else scores @ (axes[:, kept] / np.sqrt(squares[kept]))
    n_free = len(X) - 1 - basis.shape[1]
    if n_free < 1:
        return np.zeros(Y.shape[1])
    left = target_scores - basis @ (basis.T @ target_scores)
    total, unexplained = (np.square(s).sum(axis=0) for s in (target_scores, left))
    share = (unexplained / n_free) / np.where(total > 0, total / (len(X) - 1), np.inf)
    share = np.where(total > 0, np.clip(share, np.finfo(float).eps, 1.0), 1.0)
    return np.asarray(-0.5 * np.log2(share))


def _error_allowed(conditional_entropy: Array) -> Array:
    return np.asarray(np.exp2(conditional_entropy) / np.sqrt(2 * np.pi * np.e))
