"""How much of the information of a histogram is there by chance, and what is left without it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.compiled import compiled
from servoscope.errors import InvalidInputError
from servoscope.selection.binning import Codes
from servoscope.selection.expected_information import expected_information
from servoscope.selection.histogram_sums import joint_counts
from servoscope.selection.mutual_information import bin_samples, information_of_codes
from servoscope.selection.ranks import at_most_entropy
from servoscope.selection.tables import one_column_each

CORRECTIONS = ("miller_madow", "chi_square", "permutation")
"""Estimates of the bias: of variables that may be related, and of unrelated ones in two ways."""


def information_bias(
    X: ArrayLike,
    y: ArrayLike,
    n_bins: int = 10,
    correction: str = "miller_madow",
) -> NDArray[np.float64]:
    """Bias of `mutual_information`, estimated, [bits].

    Parameters
    ----------
    X : array of shape (n_samples, n_features)
    y : array of shape (n_samples,) or (n_samples, n_targets)
    n_bins : int
    correction : {"miller_madow", "chi_square", "permutation"}
        ``"miller_madow"`` holds for related and unrelated variables alike, if it is somewhat small
        where cells expect less than a sample; it is negative where one variable tells nearly all
        of the other. The others are the mean of unrelated variables: ``"chi_square"`` for many
        samples in every cell, ``"permutation"`` exactly, over all orders of the samples. For
        related variables, which fill fewer cells, they are too large.

    Returns
    -------
    ndarray of shape (n_features,) or (n_features, n_targets)

    Raises
    ------
    InvalidInputError
        If the samples do not fit, or the correction is unknown.

    Notes
    -----
    With ``K_x``, ``K_y`` and ``K_xy`` the numbers of occupied bins and cells of n samples,
    Miller-Madow is ``(K_xy - K_x - K_y + 1) / (2 n ln 2)`` and the mean of chi-square
    ``(K_x - 1) (K_y - 1) / (2 n ln 2)``. They are equal where all cells are occupied.

    References
    ----------
    G. Miller, "Note on the bias of information estimates", in H. Quastler (ed.), Information
    Theory in Psychology, 1955.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> X, y = rng.uniform(size=(1000, 100)), rng.uniform(size=1000)
    >>> from servoscope.selection import mutual_information
    >>> f"{mutual_information(X, y).mean():.3f} {information_bias(X, y).mean():.3f}"
    '0.058 0.058'
    """
    return one_column_each(_bias(*bin_samples(X, y, n_bins), n_bins, correction), y)


def corrected_mutual_information(
    X: ArrayLike,
    y: ArrayLike,
    n_bins: int = 10,
    correction: str = "miller_madow",
) -> NDArray[np.float64]:
    """Mutual information of every feature with every target less its bias, [bits].

    Parameters
    ----------
    X, y, n_bins, correction
        As of `information_bias`.

    Returns
    -------
    ndarray of shape (n_features,) or (n_features, n_targets)
        At most the entropy of either binned variable. Values below 0 stand as they are, so that
        unrelated variables have a mean of 0; clip them where information is summed or compared
        with a threshold.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> X, y = rng.uniform(size=(1000, 100)), rng.uniform(size=1000)
    >>> abs(corrected_mutual_information(X, y).mean()) < 0.001
    np.True_
    """
    codes, targets = bin_samples(X, y, n_bins)
    corrected = information_of_codes(codes, targets, n_bins)
    corrected -= _bias(codes, targets, n_bins, correction)
    return one_column_each(at_most_entropy(corrected, codes.T, targets.T), y)


def _bias(codes: Codes, targets: Codes, n_bins: int, correction: str) -> NDArray[np.float64]:
    if correction not in CORRECTIONS:
        raise InvalidInputError(
            f"correction must be one of {', '.join(CORRECTIONS)}, got {correction!r}."
        )
    if correction == "permutation":
        return expected_information(codes, targets, n_bins)
    unrelated = correction == "chi_square"
    cells = (
        degrees_of_freedom(codes, targets) if unrelated else _excess_cells(codes, targets, n_bins)
    )
    return np.asarray(cells / (2 * codes.shape[1] * np.log(2)))


def degrees_of_freedom(a: Codes, b: Codes) -> NDArray[np.intp]:
    """(occupied bins - 1) (occupied bins - 1) of every variable of `a` with every one of `b`."""
    free_a, free_b = (np.array([len(np.unique(row)) - 1 for row in codes]) for codes in (a, b))
    return np.multiply.outer(free_a, free_b)


@compiled()
def _excess_cells(a: Codes, b: Codes, n_bins: int) -> NDArray[np.int64]:
    """Occupied cells of the joint histogram, less the occupied bins of both variables, plus 1."""
    excess = np.empty((len(a), len(b)), np.int64)
    for i in range(len(a)):
        for j in range(len(b)):
            occupied = joint_counts(a[i], b[j], n_bins) > 0
            bins_a = bins_b = 0
            for k in range(n_bins):
                bins_a += occupied[k].any()
                bins_b += occupied[:, k].any()
            excess[i, j] = occupied.sum() - bins_a - bins_b + 1
    return excess
