"""The samples that a regressor learns from, checked."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator
from sklearn.utils.validation import validate_data

from servoscope.arrays import check_scale, check_unmasked
from servoscope.errors import InvalidInputError
from servoscope.kernels.repeats import Groups, find_repeats, merge_repeats

Array = NDArray[np.float64]

_LEAST_SHARE = 1e-12
"""Of its size, a target that never changes is known to as much."""


class Samples(NamedTuple):
    """Features (n, k) and target (n,)."""

    X: Array
    y: Array

    def joined(self, others: Samples | None) -> Samples:
        """These samples with others behind them, if there are any."""
        if others is None:
            return self
        return Samples(np.vstack([self.X, others.X]), np.concatenate([self.y, others.y]))


class Shots(NamedTuple):
    """Samples of which some may be repeated shots of one pose: those count as one sample."""

    each: Samples
    """Every shot."""
    poses: Samples
    """The mean of the shots of each pose."""
    members: Groups
    """Which pose each shot is of."""

    def noise_within(self, residuals: Array) -> float:
        """Variance of the residuals of shots about their pose's mean, on the average of poses."""
        return float(np.mean(self.mean_of_poses(np.square(residuals - self._own_mean(residuals)))))

    def mean_of_poses(self, values: Array) -> Array:
        """The mean over the shots of each pose."""
        return merge_repeats(values, values, self.members)[0]

    def _own_mean(self, values: Array) -> Array:
        return self.mean_of_poses(values)[self.members]


def check_samples(
    estimator: BaseEstimator,
    X: ArrayLike,
    y: ArrayLike,
    X_val: ArrayLike | None,
    y_val: ArrayLike | None,
    poses: ArrayLike | None = None,
) -> tuple[Shots, Shots | None]:
    """Training and validation samples in double precision; the estimator learns their width.

    Validation samples of poses that are trained on are training samples: they show nothing of
    other poses. There are no validation samples if none are left.

    Raises
    ------
    InvalidInputError
        If only one of X_val and y_val is given, values are masked or beyond 1e30, or `poses`
        is not one value for each sample.
    ValueError
        If an array is empty, has the wrong shape or holds NaN or infinity, or there is one
        training sample.
    """
    if (X_val is None) != (y_val is None):
        raise InvalidInputError("X_val and y_val belong together: give both, or neither.")
    training = _check(estimator, X, y, reset=True)
    validation = None if X_val is None else _check(estimator, X_val, y_val, reset=False)
    return group_shots(training, validation, poses)


def group_shots(
    training: Samples, validation: Samples | None, poses: ArrayLike | None = None
) -> tuple[Shots, Shots | None]:
    """Shots to learn from, and those of other poses, if any; see `check_samples`."""
    joined, n = training.joined(validation), len(training.y)
    members = find_repeats(*joined) if poses is None else _as_groups(poses, len(joined.y))
    trained = np.isin(members, members[:n])
    learned = _shots(joined, members, trained)
    return learned, None if trained.all() else _shots(joined, members, ~trained)


def least_deviation(y: Array) -> float:
    """The standard deviation of targets that are all the same: not quite none."""
    return _LEAST_SHARE * (float(np.abs(y).max()) or 1.0)


def check_arrays(arrays: Mapping[str, Any], names: tuple[str, ...], owner: str) -> list[Array]:
    """The named arrays in double precision.

    Raises
    ------
    InvalidInputError
        If one is missing.
    """
    missing = set(names) - set(arrays)
    if missing:
        raise InvalidInputError(
            f"{owner} needs the array {min(missing)!r}, got {', '.join(sorted(arrays))}."
        )
    return [np.asarray(arrays[name], dtype=np.float64) for name in names]


def _check(estimator: BaseEstimator, X: Any, y: Any, reset: bool) -> Samples:
    check_unmasked(X, "X")
    check_unmasked(y, "y")
    X, y = validate_data(
        estimator,
        *(X, y),
        reset=reset,
        dtype=np.float64,
        y_numeric=True,
        ensure_min_samples=2 if reset else 1,
    )
    # In one order of memory: that of a sum shows in its last bits.
    samples = Samples(np.ascontiguousarray(X), y.astype(np.float64))
    check_scale(samples.X, "X")
    check_scale(samples.y, "y")
    return samples


def _shots(samples: Samples, members: Groups, chosen: NDArray[np.bool_]) -> Shots:
    each = samples if chosen.all() else Samples(samples.X[chosen], samples.y[chosen])
    members = np.unique(members[chosen], return_inverse=True)[1].astype(np.intp)
    if members.max() + 1 == len(members):
        return Shots(each, each, np.arange(len(members)))
    return Shots(each, Samples(*merge_repeats(*each, members)), members)


def _as_groups(poses: ArrayLike, n: int) -> Groups:
    values = np.asarray(poses)
    if values.shape != (n,):
        raise InvalidInputError(
            f"poses must be {n} values, one for each sample, those of validation behind, got the "
            f"shape {values.shape}."
        )
    return np.unique(values, return_inverse=True)[1].astype(np.intp)
