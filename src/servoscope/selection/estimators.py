"""Mutual information by histograms: the plug-in estimate, its bias, and tests against chance."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from numbers import Integral

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import chi2, false_discovery_control, gamma

from servoscope.errors import InvalidInputError
from servoscope.selection.histograms import (
    Codes,
    at_most_entropy,
    bin_codes,
    expected_information,
    information_of_codes,
    quantile_codes,
)
from servoscope.selection.samples import as_samples, as_targets, check_as_many, one_column_each


def mutual_information(X: ArrayLike, y: ArrayLike, n_bins: int = 10) -> NDArray[np.float64]:
    """Mutual information of every feature with every target, [bits].

    Parameters
    ----------
    X : array of shape (n_samples, n_features)
    y : array of shape (n_samples,) or (n_samples, n_targets)
    n_bins : int
        Number of equal-width bins over the observed range of each variable, 2 to 256.

    Returns
    -------
    ndarray of shape (n_features,) or, for two-dimensional `y`, (n_features, n_targets)
        Exactly 0 where the feature or the target is constant.

    Raises
    ------
    InvalidInputError
        If a value is NaN or infinite, the numbers of samples differ, or `n_bins` is out of range.

    Notes
    -----
    Equation 19 of Wells and Torras (2001) with relative frequencies for the probabilities. This
    plug-in estimate is biased upwards: two unrelated variables show about
    ``(n_bins - 1)^2 / (2 n_samples ln 2)`` bits, 0.058 for 10 bins and 1000 samples.

    Examples
    --------
    >>> x = np.arange(1000.0)
    >>> mutual_information(np.column_stack([x, -x, np.zeros(1000)]), x).round(3)
    array([3.322, 3.322, 0.   ])
    """
    codes, targets = bin_samples(X, y, n_bins)
    return one_column_each(information_of_codes(codes, targets, n_bins)[0], y)


def pairwise_mutual_information(X: ArrayLike, n_bins: int = 10) -> NDArray[np.float64]:
    """Mutual information of every two features, [bits].

    Parameters
    ----------
    X : array of shape (n_samples, n_features)
    n_bins : int
        Number of equal-width bins over the observed range of each feature, 2 to 256.

    Returns
    -------
    ndarray of shape (n_features, n_features)
        Symmetric; on the diagonal stands the entropy of the binned feature.

    Raises
    ------
    InvalidInputError
        If a value is NaN or infinite, or `n_bins` is out of range.

    Examples
    --------
    >>> pairwise_mutual_information(np.arange(8.0)[:, None] * [1, -1], n_bins=4)
    array([[2., 2.],
           [2., 2.]])
    """
    codes = bin_codes(X, n_bins)
    return information_of_codes(codes, codes, n_bins)[0]


def bin_samples(X: ArrayLike, y: ArrayLike, n_bins: int) -> tuple[Codes, Codes]:
    """Bins of the features and of the targets, one row a variable."""
    codes, target_codes = bin_codes(X, n_bins), bin_codes(as_targets(y), n_bins, name="y")
    check_as_many(codes.shape[1], target_codes.shape[1])
    return codes, target_codes


CORRECTIONS = ("miller_madow", "permutation")
"""Estimates of the bias: of variables that may be related, and of unrelated ones."""


def information_bias(
    X: ArrayLike,
    y: ArrayLike,
    n_bins: int = 10,
    correction: str = "miller_madow",
) -> NDArray[np.float64]:
    """Bias of `mutual_information`, estimated, [bits].

    ``"miller_madow"`` holds for related and unrelated variables alike, if it is somewhat small
    where cells expect less than a sample; it is negative where one variable determines nearly all
    of the other. ``"permutation"`` is the mean of unrelated variables, over all orders of the
    samples; for related variables, which fill fewer cells, it is too large.

    Notes
    -----
    With ``K_x``, ``K_y`` and ``K_xy`` the numbers of occupied bins and cells of n samples,
    Miller-Madow is ``(K_xy - K_x - K_y + 1) / (2 n ln 2)``.

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
    return one_column_each(_estimate(*bin_samples(X, y, n_bins), n_bins, correction)[1], y)


def corrected_mutual_information(
    X: ArrayLike,
    y: ArrayLike,
    n_bins: int = 10,
    correction: str = "miller_madow",
) -> NDArray[np.float64]:
    """Mutual information of every feature with every target less its bias, [bits], as of
    `information_bias`. It is at most the entropy of either binned variable. Values below 0 stand as
    they are, so that unrelated variables have a mean of 0; clip them where information is summed or
    compared with a threshold.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> X, y = rng.uniform(size=(1000, 100)), rng.uniform(size=1000)
    >>> abs(corrected_mutual_information(X, y).mean()) < 0.001
    np.True_
    """
    codes, targets = bin_samples(X, y, n_bins)
    information, bias = _estimate(codes, targets, n_bins, correction)
    return one_column_each(at_most_entropy(information - bias, codes.T, targets.T), y)


def _estimate(
    codes: Codes, targets: Codes, n_bins: int, correction: str
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Information and its bias."""
    if correction not in CORRECTIONS:
        raise InvalidInputError(
            f"correction must be one of {', '.join(CORRECTIONS)}, got {correction!r}."
        )
    information, bias = information_of_codes(codes, targets, n_bins)
    if correction == "permutation":
        bias = expected_information(codes, targets, n_bins)
    return information, bias


NULLS = ("chi_square", "shifts")
"""What unrelated variables are supposed to show."""

_ROUNDING = 1e-12
"""Information that is as much as the observed but for the order of its summation, [bits]."""

_FEW, _ENOUGH = 10, 50
"""Shifts that show as much: fewer are not counted but extrapolated, from at least 50."""


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
    n_shifts: int = 999,
    random_state: int = 0,
) -> InformationTest:
    """Test every feature for information about every target.

    Parameters
    ----------
    X : array of shape (n_samples, n_features)
    y : array of shape (n_samples,) or (n_samples, n_targets)
    n_bins : int
        Equal-width bins over the observed range of each variable.
    null : {"chi_square", "shifts"}
        Where the p-values come from. The first supposes independent samples. For the images of a
        sequence, which resemble their neighbours, it finds information everywhere; ``"shifts"``
        turn the whole sequence of targets as a ring, which keeps all of its dependence but at the
        seam.
    level : float
        Greatest expected share of wrong findings among all features and targets together.
    n_shifts : int
        How many shifts, drawn at random, each at most once.
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

    A p-value of shifts is the share of them that show as much, the samples as they are counted
    too. Where fewer than 10 do, of 50 or more, it is the tail of the gamma distribution with the
    mean and variance of the shifts: by counting alone, the few shifts of a short sequence could
    never show one finding among hundreds of features. The findings are those of Benjamini and
    Hochberg (1995).

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
    if null not in NULLS:
        raise InvalidInputError(f"null must be one of {', '.join(NULLS)}, got {null!r}.")
    if not 0 < level < 1:
        raise InvalidInputError(f"level must be between 0 and 1, got {level!r}.")
    if not isinstance(n_shifts, Integral) or n_shifts < 1:
        raise InvalidInputError(f"n_shifts must be 1 or more, got {n_shifts!r}.")
    codes, targets = bin_samples(X, y, n_bins)
    information, _ = information_of_codes(codes, targets, n_bins)
    if null == "chi_square":
        null_mean = expected_information(codes, targets, n_bins)
        p_values = _chi_square_p_values(codes, targets, information, null_mean)
    else:
        drawn = np.random.default_rng(random_state).permutation(codes.shape[1] - 1)[:n_shifts]
        nulls = (
            information_of_codes(codes, np.roll(targets, 1 + shift, axis=1), n_bins)[0]
            for shift in drawn
        )
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
    free = (np.array([len(np.unique(row)) - 1 for row in c]) for c in (codes, targets))
    dof = np.maximum(np.multiply.outer(*free), 1)
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
    return gamma.sf(x, mean**2 / variance, scale=variance / mean)


Array = NDArray[np.float64]


def equal_frequency_information(
    X: ArrayLike, y: ArrayLike, n_bins: int = 10
) -> NDArray[np.float64]:
    """Mutual information of every feature with every target from bins of equal frequency, [bits].

    It does not change when a variable is replaced by a growing function of it; all else is as of
    `mutual_information`.

    Examples
    --------
    >>> x = np.arange(1000.0)
    >>> equal_frequency_information(x[:, None], np.exp(x / 100)).round(3)
    array([3.322])
    """
    codes, targets = (quantile_codes(table, n_bins) for table in as_samples(X, y))
    return one_column_each(information_of_codes(codes, targets, n_bins)[0], y)
