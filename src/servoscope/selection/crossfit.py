"""A forecast for features that are fitted to the images, fitted anew without those that count."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.errors import InvalidInputError
from servoscope.kernels import KernelPosterior, find_repeats, fit_kernel, merge_repeats, whole_poses
from servoscope.processes import in_processes, one_blas_thread
from servoscope.selection.forecast import (
    Array,
    Forecast,
    check_coverage,
    check_groups,
    cut_samples,
    summarise_residuals,
)
from servoscope.selection.rms_interval import root_mean_square
from servoscope.selection.samples import as_samples, as_table, group_poses, in_ordinary_units

Progress = Callable[[int], object]
Indices = NDArray[np.intp]

_LEAST_GAIN = 0.8
"""Nothing is hoped from the samples left out that would lower an error by more than this."""


class FeatureFamily(Protocol):
    """Features that are fitted to images and to their targets."""

    def fit(self, images: Any, Y: Any) -> Any:
        """Fit to training images."""

    def transform(self, images: Any) -> Any:
        """Features of images, one row each."""


@dataclass(frozen=True, eq=False)
class Fold:
    """Features of all images, fitted without those of one part.

    Parameters
    ----------
    left_out : ndarray
        Indices of the images that did not fit the features.
    X : ndarray of shape (n_images, n_features)
    """

    left_out: Indices
    X: Array


def crossfit_forecast(
    family: FeatureFamily,
    images: NDArray[Any],
    Y: ArrayLike,
    *,
    groups: ArrayLike | None = None,
    n_folds: int = 5,
    coverage: float = 0.9,
    n_jobs: int | None = 1,
    max_samples: int = 300,
    max_iter: int = 25,
    on_progress: Progress | None = None,
) -> Forecast:
    """The RMS error that each target will reach from features that are fitted to images.

    `forecast_errors` is enough for features that need no fitting. Those fitted to the training
    images, and even more so to their poses, inform more about these images than about new ones.

    Parameters
    ----------
    family : object with ``fit(images, Y)`` and ``transform(images)``
        Is left as it is; copies of it are fitted.
    images : array of shape (n_images, ...)
    Y : array of shape (n_images, n_targets) or (n_images,)
    groups : array of shape (n_images,), optional
        What is left out together, such as the blocks of a sequence; 4 groups at least.
    n_folds : int
        Parts that are left out in turn, 2 at least.
    coverage, n_jobs, max_samples, max_iter
        As of `forecast_errors`.
    on_progress : callable, optional
        Called with the number of folds whose features are there.

    Returns
    -------
    Forecast

    Raises
    ------
    InvalidInputError
        If `Y` or the features are not finite, or there are too few images, groups or folds.

    Notes
    -----
    Features and kernel are fitted without one part, whose images are then predicted. That is an
    error from fewer images than there are. How much the others are worth is taken from leaving as
    large a share once more out of those that predict: errors fall as a power of the number of
    images, so that equal ratios of images give equal ratios of errors.

    Examples
    --------
    >>> class Sums:
    ...     def fit(self, images, Y):
    ...         return self
    ...     def transform(self, images):
    ...         return images.sum(axis=1)
    >>> rng = np.random.default_rng(0)
    >>> images = rng.uniform(size=(200, 4, 2))
    >>> y = np.sin(images.sum(axis=1)[:, 0]) + rng.normal(0, 0.1, 200)
    >>> crossfit_forecast(Sums(), images, y).rms.round(1)
    array([0.1])
    """
    folds = refit_features(
        family, images, Y, groups=groups, n_folds=n_folds, on_progress=on_progress
    )
    return forecast_from_folds(
        folds,
        Y,
        groups=groups,
        coverage=coverage,
        n_jobs=n_jobs,
        max_samples=max_samples,
        max_iter=max_iter,
    )


def refit_features(
    family: FeatureFamily,
    images: NDArray[Any],
    Y: ArrayLike,
    *,
    groups: ArrayLike | None = None,
    n_folds: int = 5,
    on_progress: Progress | None = None,
) -> list[Fold]:
    """Features of all images, fitted anew without each part of them in turn.

    Parameters
    ----------
    family, images, Y, groups, n_folds, on_progress
        As of `crossfit_forecast`.

    Returns
    -------
    list of Fold
    """
    _, targets = as_samples(np.arange(len(images))[:, None], Y)
    folds = []
    for left_out in cut_folds(targets, groups, n_folds):
        used = np.delete(np.arange(len(images)), left_out)
        fitted = deepcopy(family).fit(images[used], targets[used])
        folds.append(Fold(left_out, as_table(fitted.transform(images), "The features")))
        if on_progress is not None:
            on_progress(len(folds))
    return folds


def cut_folds(Y: Array, groups: ArrayLike | None, n_folds: int) -> list[Indices]:
    """Parts of the images to leave out in turn, which divide no group and no pose.

    Raises
    ------
    InvalidInputError
        If there are too few images, groups or folds.
    """
    if n_folds < 2:
        raise InvalidInputError(f"n_folds must be 2 or more, got {n_folds!r}.")
    members = _of_shots(in_ordinary_units(Y)[0], check_groups(groups, len(Y)))
    return cut_samples(len(Y), members, n_folds)


def forecast_from_folds(
    folds: Sequence[Fold],
    Y: ArrayLike,
    *,
    columns: ArrayLike | None = None,
    groups: ArrayLike | None = None,
    poses: ArrayLike | None = None,
    coverage: float = 0.9,
    n_jobs: int | None = 1,
    max_samples: int = 300,
    max_iter: int = 25,
) -> Forecast:
    """The forecast that features fitted anew in folds allow.

    Parameters
    ----------
    folds : sequence of Fold
        From `refit_features`; they serve for any number of subsets of features.
    Y : array of shape (n_images, n_targets) or (n_images,)
    columns : array of int, optional
        The features that count; all of them by default.
    groups, poses, coverage, n_jobs, max_samples, max_iter
        As of `forecast_errors`.

    Returns
    -------
    Forecast
    """
    check_coverage(coverage)
    chosen = slice(None) if columns is None else np.asarray(columns, dtype=np.intp)
    tables = [as_samples(fold.X[:, chosen], Y) for fold in folds]
    members = check_groups(groups, len(tables[0][0]))
    targets, unit = in_ordinary_units(tables[0][1])
    targets = targets - targets[0]  # what never changes is exactly 0
    features = [in_ordinary_units(X)[0] for X, _ in tables]
    if poses is None:
        of_folds = [find_repeats(X, targets) for X in features]
    else:
        of_folds = [np.asarray(poses)] * len(features)
    effort = {"max_samples": max_samples, "max_iter": max_iter}
    calls = [
        (X, y, of_fold, fold.left_out, effort)
        for y in targets.T
        for fold, X, of_fold in zip(folds, features, of_folds, strict=True)
    ]
    full, fewer = np.empty_like(targets), np.empty_like(targets)
    for i, found in enumerate(in_processes(_residuals_left_out, calls, n_jobs)):
        rows = folds[i % len(folds)].left_out
        full[rows, i // len(folds)], fewer[rows, i // len(folds)] = found
    residuals = full * _gain(root_mean_square(full), root_mean_square(fewer))
    counted = group_poses(features[0], targets, _of_shots(targets, members), poses)
    return summarise_residuals(residuals, counted, targets, coverage).in_units(unit)


def _of_shots(targets: Array, groups: Indices | None) -> Indices | None:
    """Groups of images in which none of those of equal or next to equal targets are divided."""
    poses = find_repeats(targets, targets)
    if groups is not None:
        return whole_poses(poses, groups)
    return poses if poses.max() + 1 < len(poses) else None


def _residuals_left_out(
    X: Array, y: Array, members: Indices, left_out: Indices, effort: dict[str, int]
) -> tuple[Array, Array]:
    """Residuals from all other samples, and from fewer of them by the same ratio once more."""
    others = np.delete(np.arange(len(X)), left_out)
    _, poses = np.unique(members[others], return_inverse=True)
    X_used, y_used = merge_repeats(X[others], y[others], poses)
    n_fewer = round(len(y_used) * len(others) / len(X))
    fewer = np.sort(np.random.default_rng(0).permutation(len(y_used))[:n_fewer])
    with one_blas_thread():
        kernel = fit_kernel(X_used, y_used, **effort)
        return (
            y[left_out] - KernelPosterior(kernel, X_used, y_used).mean(X[left_out]),
            y[left_out] - KernelPosterior(kernel, X_used[fewer], y_used[fewer]).mean(X[left_out]),
        )


def _gain(rms: Array, rms_of_fewer: Array) -> Array:
    """By how much the samples left out lower the error."""
    ratio = np.divide(rms, rms_of_fewer, out=np.ones_like(rms), where=rms_of_fewer > 0)
    return np.clip(ratio, _LEAST_GAIN, 1.0)
