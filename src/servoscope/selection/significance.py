"""Which features tell anything of a target at all: tests against chance."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.errors import InvalidInputError
from servoscope.selection.bias import degrees_of_freedom
from servoscope.selection.binning import Codes
from servoscope.selection.expected_information import expected_information
from servoscope.selection.mutual_information import bin_samples, information_of_codes
from servoscope.selection.surrogates import REARRANGEMENTS, rearrangements
from servoscope.selection.tables import one_column_each

NULLS = ("chi_square", *REARRANGEMENTS)
"""What unrelated variables are supposed to show."""

_ROUNDING = 1e-12
"""Information that is as much as the observed but for the order of its summation, [bits]."""

_FEW, _ENOUGH = 10, 50
"""Rearrangements that show as much: fewer are not counted but extrapolated, from at least 50."""


@dataclass(frozen=True, eq=False)
class InformationTest:
    """Information of every feature about every target, and whether it is more than chance.

    All arrays have the shape (n_features,) or (n_features, n_targets).

    Parameters
    ----------
    information : ndarray
        As `mutual_information` gives it, [bits].
    null_mean : ndarray
        What it would be on the average for unrelated variables, [bits].
    p_values : ndarray
        Chance that unrelated variables show as much or more.
    significant : ndarray of bool
        Those that are found when at most a share of `level` of all that are found is to be wrong.
    level : float
    """

    information: NDArray[np.float64]
    null_mean: NDArray[np.float64]
    p_values: NDArray[np.float64]
    significant: NDArray[np.bool_]
    level: float

    @property
    def corrected(self) -> NDArray[np.float64]:
        """Information above the mean of chance, [bits]; below 0 where there is less."""
        return self.information - self.null_mean


def information_test(
    X: ArrayLike,
    y: ArrayLike,
    n_bins: int = 10,
    *,
    null: str = "chi_square",
    level: float = 0.05,
    n_permutations: int = 999,
    block_length: int | None = None,
    random_state: int = 0,
) -> InformationTest:
    """Test every feature for information about every target.

    Parameters
    ----------
    X : array of shape (n_samples, n_features)
    y : array of shape (n_samples,) or (n_samples, n_targets)
    n_bins : int
        Equal-width bins over the observed range of each variable.
    null : {"chi_square", "shuffle", "blocks", "shifts"}
        Where the p-values come from. The first two suppose independent samples. For the images of
        a sequence, which resemble their neighbours, they find information everywhere: take
        ``"shifts"``, or ``"blocks"`` with blocks several times as long as the resemblance.
    level : float
        Greatest expected share of wrong findings among all features and targets together.
    n_permutations : int
        Rearrangements of the targets.
    block_length : int, optional
        Samples in a block, for ``"blocks"``.
    random_state : int

    Returns
    -------
    InformationTest

    Raises
    ------
    InvalidInputError
        If the samples do not fit, or a parameter is out of range.

    Notes
    -----
    ``2 n ln 2`` times the information of unrelated variables is chi-square distributed with
    ``(K_x - 1) (K_y - 1)`` degrees of freedom for many samples, ``K`` being the numbers of
    occupied bins. With few samples a cell that is far off: of 240 uniform samples in 10 bins it
    rejects 22 % at a level of 5 %, of exponential ones none. So, after Bartlett, the statistic is
    scaled to the mean that it has over all orders of the samples (see `information_bias`), after
    which 1 to 7 % were rejected in all of many simulations with 100 to 1000 samples.

    A p-value of rearrangements is the share of them that show as much, the samples as they are
    counted too. Where fewer than 10 do, of 50 or more, it is the tail of the gamma distribution
    with the mean and variance of the rearrangements: by counting alone, the few shifts of a short
    sequence could never tell one finding among hundreds of features. The findings are those of
    Benjamini and Hochberg (1995).

    References
    ----------
    Y. Benjamini and Y. Hochberg, "Controlling the false discovery rate", Journal of the Royal
    Statistical Society B 57, 1995.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> X = rng.uniform(size=(500, 3))
    >>> test = information_test(X, X[:, 1] + 0.3 * rng.normal(size=500))
    >>> test.significant
    array([False,  True, False])
    """
    from scipy.stats import false_discovery_control

    if null not in NULLS:
        raise InvalidInputError(f"null must be one of {', '.join(NULLS)}, got {null!r}.")
    if not 0 < level < 1:
        raise InvalidInputError(f"level must be between 0 and 1, got {level!r}.")
    codes, targets = bin_samples(X, y, n_bins)
    information = information_of_codes(codes, targets, n_bins)
    if null == "chi_square":
        null_mean = expected_information(codes, targets, n_bins)
        p_values = _chi_square_p_values(codes, targets, information, null_mean)
    else:
        orders = rearrangements(codes.shape[1], null, n_permutations, block_length, random_state)
        nulls = (information_of_codes(codes, targets[:, order], n_bins) for order in orders)
        null_mean, p_values = _against_nulls(nulls, information)
    adjusted = false_discovery_control(p_values, axis=None).reshape(p_values.shape)
    return InformationTest(
        information=one_column_each(information, y),
        null_mean=one_column_each(null_mean, y),
        p_values=one_column_each(p_values, y),
        significant=one_column_each(adjusted <= level, y),
        level=level,
    )


def _chi_square_p_values(
    codes: Codes,
    targets: Codes,
    information: NDArray[np.float64],
    null_mean: NDArray[np.float64],
) -> NDArray[np.float64]:
    from scipy.stats import chi2

    dof = np.maximum(degrees_of_freedom(codes, targets), 1)
    # What never differs has no mean to scale to: it shows exactly 0, and its p-value is 1.
    statistic = dof * information / np.where(null_mean > 0, null_mean, 1.0)
    return chi2.sf(statistic, dof)


def _against_nulls(
    nulls: Iterator[NDArray[np.float64]], information: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    n_nulls, as_much = 0, np.zeros_like(information)
    total, squares = np.zeros_like(information), np.zeros_like(information)
    for null in nulls:
        n_nulls += 1
        total += null
        squares += null**2
        as_much += null >= information - _ROUNDING
    mean = total / max(n_nulls, 1)
    variance = squares / max(n_nulls, 1) - mean**2
    p_values = (as_much + 1) / (n_nulls + 1)
    tail = (as_much < _FEW) & (variance > _ROUNDING**2) & (n_nulls >= _ENOUGH)
    p_values[tail] = _gamma_tail(information[tail], mean[tail], variance[tail])
    return mean, p_values


def _gamma_tail(
    x: NDArray[np.float64], mean: NDArray[np.float64], variance: NDArray[np.float64]
) -> NDArray[np.float64]:
    from scipy.stats import gamma

    return gamma.sf(x, mean**2 / variance, scale=variance / mean)
