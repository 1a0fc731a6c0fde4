"""What regressors share: samples that are checked, repeated shots of a pose, predictions."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, Literal, NamedTuple, Self, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.utils.validation import check_is_fitted, validate_data

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


class SampleRegressor(RegressorMixin, BaseEstimator):
    """What the regressors here share: samples that are checked, and how they are asked."""

    @abstractmethod
    def _check_parameters(self) -> None:
        """Raise InvalidInputError where a parameter is out of range."""

    @abstractmethod
    def _learn(self, learned: Shots, others: Shots | None) -> None:
        """Learn from shots, and from or by those of other poses, if there are any."""

    @abstractmethod
    def _mean(self, X: Array) -> Array:
        """The target at checked samples."""

    @abstractmethod
    def _deviation(self, X: Array) -> Array:
        """Standard deviation of a new target at checked samples."""

    def fit(
        self,
        X: ArrayLike,
        y: ArrayLike,
        X_val: ArrayLike | None = None,
        y_val: ArrayLike | None = None,
        poses: ArrayLike | None = None,
    ) -> Self:
        """Learn from samples X (n, k) and y (n,).

        Parameters
        ----------
        X, y : arrays of shape (n, n_features) and (n,)
            Two samples at least.
        X_val, y_val : arrays of shape (n_val, n_features) and (n_val,), optional
            They stop the training of networks that need it. Other regressors learn from them as
            well, once their errors have raised or lowered the predicted standard deviation. Those
            of poses that are trained on are training samples.
        poses : array of shape (n,) or (n + n_val,), optional
            Samples of equal value are repeated shots of one pose, which count as one sample, their
            mean. By default they are found (`servoscope.kernels.find_repeats`).

        Returns
        -------
        self

        Raises
        ------
        InvalidInputError
            If a parameter is out of range, only one of X_val and y_val is given, or values are
            masked or beyond 1e30.
        ValueError
            If an array is empty, has the wrong shape or holds NaN or infinity, or there is one
            sample only.
        """
        self._check_parameters()
        self._learn(*check_samples(self, X, y, X_val, y_val, poses))
        return self

    @overload
    def predict(self, X: ArrayLike, return_std: Literal[False] = False) -> Array: ...
    @overload
    def predict(self, X: ArrayLike, return_std: Literal[True]) -> tuple[Array, Array]: ...
    def predict(self, X: ArrayLike, return_std: bool = False) -> Array | tuple[Array, Array]:
        """The target at samples X of shape (n, n_features_in_).

        Parameters
        ----------
        X : array of shape (n, n_features_in_)
        return_std : bool

        Returns
        -------
        y : ndarray of shape (n,)
        std : ndarray of shape (n,)
            Only if `return_std`: the standard deviation of a new target, its noise included.

        Raises
        ------
        InvalidInputError
            If values are masked or beyond 1e30, or the deviation is asked for and unknown, as it is
            of networks that were kept as arrays before it was kept with them.
        """
        samples = self._check_features(X)
        mean = self._mean(samples)
        return (mean, self._deviation(samples)) if return_std else mean

    def _check_features(self, X: ArrayLike) -> Array:
        check_is_fitted(self)
        check_unmasked(X, "X")
        features = np.asarray(validate_data(self, X, reset=False, dtype=np.float64))
        check_scale(features, "X")
        return features

    def _with_names(self, arrays: dict[str, NDArray]) -> dict[str, NDArray]:
        """The arrays, with the names of the features if X had any."""
        if hasattr(self, "feature_names_in_"):
            arrays["feature_names"] = np.asarray(self.feature_names_in_, dtype=str)
        return arrays

    def _take_names(self, n_features: int, arrays: Mapping[str, ArrayLike]) -> None:
        """Take the number of features and, if they are there, their names."""
        self.n_features_in_ = n_features
        if "feature_names" in arrays:
            self.feature_names_in_ = np.asarray(arrays["feature_names"], dtype=object)


def check_samples(
    estimator: BaseEstimator,
    X: ArrayLike,
    y: ArrayLike,
    X_val: ArrayLike | None,
    y_val: ArrayLike | None,
    poses: ArrayLike | None = None,
) -> tuple[Shots, Shots | None]:
    """Training and validation samples in double precision; the estimator learns their width.

    Validation samples of poses that are trained on are training samples: they show nothing of other
    poses. There are no validation samples if none are left.
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
    """The named arrays in double precision; one that is missing is an error."""
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


def calibration_ratio(errors: Array, expected: Array) -> float:
    """RMS of errors, each in units of the standard deviation that was expected of it.

    It is 1 where nothing can be said: where there are no errors at all, or none were expected.

    Examples
    --------
    >>> calibration_ratio(np.array([3.0, -8.0]), np.array([1.5, 4.0]))
    2.0
    """
    if not expected.all() or not errors.any():
        return 1.0
    return float(np.sqrt(np.mean((errors / expected) ** 2)))
