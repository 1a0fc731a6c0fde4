"""The samples that a regressor learns from, checked."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator
from sklearn.utils.validation import validate_data

from servoscope.errors import InvalidInputError

Array = NDArray[np.float64]


class Samples(NamedTuple):
    """Features (n, k) and target (n,)."""

    X: Array
    y: Array

    def joined(self, others: Samples | None) -> Samples:
        """These samples with others behind them, if there are any."""
        if others is None:
            return self
        return Samples(np.vstack([self.X, others.X]), np.concatenate([self.y, others.y]))


def check_samples(
    estimator: BaseEstimator,
    X: ArrayLike,
    y: ArrayLike,
    X_val: ArrayLike | None,
    y_val: ArrayLike | None,
) -> tuple[Samples, Samples | None]:
    """Training and validation samples in double precision; the estimator learns their width.

    Raises
    ------
    InvalidInputError
        If only one of X_val and y_val is given.
    ValueError
        If an array is empty, has the wrong shape or holds NaN or infinity.
    """
    if (X_val is None) != (y_val is None):
        raise InvalidInputError("X_val and y_val belong together: give both, or neither.")
    training = _check(estimator, X, y, reset=True)
    return training, None if X_val is None else _check(estimator, X_val, y_val, reset=False)


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
    X, y = validate_data(estimator, X, y, reset=reset, dtype=np.float64, y_numeric=True)
    # In one order of memory: that of a sum shows in its last bits.
    return Samples(np.ascontiguousarray(X), y.astype(np.float64))
