"""Samples as every estimate takes them: checked tables, in ordinary units, one a pose."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.arrays import as_numbers
from servoscope.errors import InvalidInputError
from servoscope.kernels.repeats import find_repeats, merge_repeats, whole_poses

_LARGEST = 1e60


def as_table(X: ArrayLike, name: str = "X") -> NDArray[np.float64]:
    """A contiguous table of numbers, one row a sample; its values may be NaN or infinite."""
    values = as_numbers(X, name)
    if values.ndim != 2 or 0 in values.shape:
        raise InvalidInputError(
            f"{name} must be a table of shape (n_samples, n_columns) with at least one of each, "
            f"got the shape {values.shape}."
        )
    return values


def as_targets(y: ArrayLike) -> NDArray[np.float64]:
    """Targets as a table; a single one is its only column."""
    values = as_numbers(y, "y")
    return as_table(values[:, None] if values.ndim == 1 else values, "y")


def check_span(low: NDArray[np.float64], high: NDArray[np.float64], name: str = "X") -> None:
    """Raise InvalidInputError unless the least and greatest value of each column span a number."""
    with np.errstate(over="ignore", invalid="ignore"):
        bad = np.flatnonzero(~np.isfinite(high - low))
    if bad.size:
        raise InvalidInputError(
            f"{name} must be finite and span less than 1.8e308, but column {bad[0]} holds NaN, "
            f"infinity or larger numbers ({bad.size} such columns); remove or mend those values."
        )


def as_samples(X: ArrayLike, y: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Features and targets as finite tables of as many samples; one target is one column."""
    features, targets = as_table(X), as_targets(y)
    check_span(features.min(axis=0), features.max(axis=0))
    check_span(targets.min(axis=0), targets.max(axis=0), "y")
    check_as_many(len(features), len(targets))
    return features, targets


def in_ordinary_units(
    table: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A table whose squares are numbers, and the unit of each column.

    Columns of values beyond `_LARGEST`, or that span less than its inverse, are counted from their
    first value in a power of two, which is exact; all others stay as they are.
    """
    span = np.ptp(table, axis=0)
    extreme = (np.abs(table).max(axis=0) > _LARGEST) | ((span > 0) & (span < 1 / _LARGEST))
    if not extreme.any():
        return table, np.ones(table.shape[1])
    unit = np.where(extreme & (span > 0), np.ldexp(1.0, np.frexp(span)[1] - 1), 1.0)
    return np.where(extreme, (table - table[0]) / unit, table), unit


def one_column_each(values: NDArray[Any], y: ArrayLike) -> NDArray[Any]:
    """Values of shape (n_features, n_targets), or (n_features,) if `y` is one-dimensional."""
    return values[:, 0] if np.ndim(y) == 1 else values


def check_as_many(n_features_samples: int, n_target_samples: int) -> None:
    """Raise InvalidInputError unless X and y have as many samples."""
    if n_features_samples != n_target_samples:
        raise InvalidInputError(
            f"X and y must have as many samples, got {n_features_samples} and {n_target_samples}."
        )


Array = NDArray[np.float64]
Groups = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Poses:
    """Samples, the repeated shots of a pose joined to their mean:

    features, targets, which poses are left out together (by default each by itself), and which pose
    each shot is of.
    """

    X: Array
    Y: Array
    groups: Groups | None
    members: Groups

    def __len__(self) -> int:
        return len(self.X)

    @property
    def groups_of_shots(self) -> Groups | None:
        """Which shots are left out together; None where each shot is by itself."""
        if self.groups is not None:
            return self.groups[self.members]
        return self.members if len(self) < len(self.members) else None


def group_poses(X: Array, Y: Array, groups: Groups | None, poses: ArrayLike | None = None) -> Poses:
    """Samples by pose; what belongs together still does, and no pose is in two groups.

    Samples of equal `poses` are shots of one; they are found by default.
    """
    members = find_repeats(X, Y) if poses is None else np.unique(poses, return_inverse=True)[1]
    merged = merge_repeats(X, Y, members)
    if groups is None:
        return Poses(*merged, None, members)
    if len(merged[0]) == len(X):
        return Poses(*merged, groups, members)
    whole = whole_poses(members, groups)
    _, first = np.unique(members, return_index=True)
    return Poses(*merged, whole[first], members)
