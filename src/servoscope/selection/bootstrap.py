"""Intervals for mutual information by resampling, for independent samples and for sequences."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.errors import InvalidInputError
from servoscope.selection.estimators import estimate_information
from servoscope.selection.surrogates import check_block_length
from servoscope.selection.tables import as_samples, one_column_each

RESAMPLINGS = ("bootstrap", "halves")


@dataclass(frozen=True, eq=False)
class InformationInterval:
    """An estimate of information and where the truth lies, [bits].

    Parameters
    ----------
    estimate, low, high : ndarray of shape (n_features,) or (n_features, n_targets)
        The estimate need not lie between the bounds: they allow for its bias.
    confidence : float
        Share of such intervals that are to hold the truth.
    """

    estimate: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    confidence: float


def information_interval(
    X: ArrayLike,
    y: ArrayLike,
    estimator: str = "histogram",
    *,
    confidence: float = 0.95,
    block_length: int = 1,
    resampling: str = "bootstrap",
    n_resamples: int = 500,
    random_state: int = 0,
    **options: Any,
) -> InformationInterval:
    """Intervals for the information of every feature about every target.

    Parameters
    ----------
    X : array of shape (n_samples, n_features)
    y : array of shape (n_samples,) or (n_samples, n_targets)
    estimator : str
        See `estimate_information`.
    confidence : float
    block_length : int
        Neighbouring samples that are drawn together: 1 for independent samples; for a sequence
        several times as many as resemble each other.
    resampling : {"bootstrap", "halves"}
        As many samples as there are in circular blocks, with replacement; or a random half of the
        blocks. The second repeats no sample: for ``"ksg"``, whose nearest neighbours would be
        repetitions, there is no other.
    n_resamples : int
    random_state : int
    **options
        Of the estimator.

    Returns
    -------
    InformationInterval

    Raises
    ------
    InvalidInputError
        If the samples do not fit, or a parameter is out of range.

    Notes
    -----
    Histograms of resamples are biased once more, by as much as that of the samples: the percentiles
    of the resamples hold the truth next to never. So the intervals are the basic ones, from
    ``2 I - q_high`` to ``2 I - q_low`` with the percentiles q of the resamples, cut at 0: they turn
    the resamples' bias round, and with it take away the estimate's. They are about what the
    estimator tends to with many samples, for a histogram the information of the bins. Half of the
    samples deviate from all as all do from the truth.

    In simulations of 300 to 600 Gaussian samples 95 % intervals held the truth 86 to 94 times in
    100; those of sequences in blocks of six times their memory 89 to 92 times, in blocks of one
    58 times. Only the bootstrap of ``"corrected_histogram"``, which takes bias away twice, held it
    77 to 87 times.

    References
    ----------
    D. Politis and J. Romano, "A circular block-resampling procedure for stationary data", in
    Exploring the Limits of Bootstrap, Wiley, 1992.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> x, noise = rng.normal(size=(2, 1000))  # 0.5 bits
    >>> interval = information_interval(x[:, None], x + noise, "gaussian_copula")
    >>> interval.low.round(2), interval.high.round(2)
    (array([0.44]), array([0.56]))
    """
    features, targets = as_samples(X, y)
    n_samples = len(features)
    _check(estimator, resampling, confidence, n_resamples)
    check_block_length(block_length, n_samples)
    rng = np.random.default_rng(random_state)
    draw = _circular_blocks if resampling == "bootstrap" else _half_of_blocks
    estimate = estimate_information(features, targets, estimator, **options)
    resampled = np.empty((n_resamples, *estimate.shape))
    for result in resampled:
        drawn = draw(n_samples, block_length, rng)
        result[:] = estimate_information(features[drawn], targets[drawn], estimator, **options)
    tail = (1 - confidence) / 2
    q_low, q_high = np.quantile(resampled, [tail, 1 - tail], axis=0)
    low, high = np.maximum(2 * estimate - q_high, 0.0), np.maximum(2 * estimate - q_low, 0.0)
    return InformationInterval(
        estimate=one_column_each(estimate, y),
        low=one_column_each(low, y),
        high=one_column_each(high, y),
        confidence=confidence,
    )


def _check(estimator: str, resampling: str, confidence: float, n_resamples: int) -> None:
    if resampling not in RESAMPLINGS:
        raise InvalidInputError(
            f"resampling must be one of {', '.join(RESAMPLINGS)}, got {resampling!r}."
        )
    if estimator == "ksg" and resampling == "bootstrap":
        raise InvalidInputError(
            "The bootstrap repeats samples, which the nearest neighbours of 'ksg' take for "
            "information; use resampling='halves'."
        )
    if not 0 < confidence < 1 or n_resamples < 1:
        raise InvalidInputError(
            "confidence must be between 0 and 1 and n_resamples at least 1, "
            f"got {confidence!r} and {n_resamples!r}."
        )


def _circular_blocks(n_samples: int, length: int, rng: np.random.Generator) -> NDArray[np.intp]:
    starts = rng.integers(n_samples, size=-(-n_samples // length))
    return ((starts[:, None] + np.arange(length)) % n_samples).ravel()[:n_samples]


def _half_of_blocks(n_samples: int, length: int, rng: np.random.Generator) -> NDArray[np.intp]:
    block = (np.arange(n_samples) + rng.integers(n_samples)) % n_samples // length
    n_blocks = -(-n_samples // length)
    return np.flatnonzero(rng.permutation(n_blocks)[block] < n_blocks // 2)
