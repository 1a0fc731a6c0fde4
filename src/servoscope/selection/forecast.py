"""The error that each target will reach on new images, said before anything is trained.

Features that are fitted to images are fitted anew without those that count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.errors import InvalidInputError
from servoscope.kernels import (
    KernelPosterior,
    find_repeats,
    fit_kernel,
    leave_out_residuals,
    merge_repeats,
    shots_left_out,
    whole_poses,
)
from servoscope.processes import in_processes, one_blas_thread
from servoscope.selection.rms_interval import (
    effective_groups,
    rms_interval,
    rms_ratio_interval,
    root_mean_square,
)
from servoscope.selection.samples import Poses, as_samples, group_poses, in_ordinary_units

Array = NDArray[np.float64]
Groups = NDArray[np.intp]

LEAST_SAMPLES = 8
"""Fewer samples are too few to choose a kernel on some of them."""

LEAST_GROUPS = 4
"""With fewer groups their spread is hardly known."""

TEST_ERROR = 1.5
"""Standard error of the logarithm of a forecast for the kernel, which is chosen on a part of the
samples, and for the training set, times the square root of the number of samples; as it was found
on simulated images (``python -m benchmarks intervals``)."""

POOLED_ERROR = 1.3
"""The same where the samples themselves are tested as well, each by a model that was trained
without its group, times the root of the number of groups: a group may be predicted better or worse
from other groups than it was."""

MOST_PARTS = 5
"""Parts into which the samples are cut at most, so that kernels are chosen on all but one."""


@dataclass(frozen=True, eq=False)
class Forecast:
    """RMS errors that the targets will reach on new images, in the unit of each target.

    Parameters
    ----------
    rms : ndarray of shape (n_targets,)
        0 for a target that never changes.
    interval : ndarray of shape (2, n_targets)
        Lower and upper end for the RMS of infinitely many images; for that of a test of few see
        `interval_of_test`.
    baseline : ndarray of shape (n_targets,)
        RMS about the mean of the other samples, or of the other groups: what is
        reached without any feature.
    residuals : ndarray of shape (n_samples, n_targets)
        Target less its prediction at each sample, from other samples.
    """

    rms: Array
    interval: Array
    baseline: Array
    residuals: Array = field(repr=False)

    @property
    def explained(self) -> Array:
        """Share of each target's variance that the features explain, 0 to 1."""
        left = np.divide(self.rms, self.baseline, out=np.ones_like(self.rms), where=self.rms > 0)
        return np.clip(1.0 - left**2, 0.0, 1.0)

    def interval_of_test(
        self, groups: Groups, tested: Groups, coverage: float = 0.9, *, share_new: float = 1.0
    ) -> Array:
        """Interval for the RMS errors that a test on images of other groups will measure.

        Parameters
        ----------
        groups : ndarray of shape (n_samples,)
            Groups of the samples that are independent of each other; each its own if they all are.
        tested : ndarray of shape (n_tested,)
            Those of the test images that are of other groups.
        coverage : float
            How often it shall hold what is measured.
        share_new : float
            Share that these are of all test images; the others are the samples themselves, each
            predicted by a model that was trained without its group.

        Returns
        -------
        ndarray of shape (2, n_targets)
            Lower and upper end; see `servoscope.selection.rms_interval.rms_ratio_interval`. The
            training set and the kernel being these and no others count as an error of
            ``1.5 / sqrt(n_samples)``, joined with one of ``1.3 / sqrt(n_groups)`` where the samples
            themselves are tested as well.
        """
        pooled = POOLED_ERROR * effective_groups(groups) ** -0.5 if share_new < 1 else 0.0
        return self.rms * rms_ratio_interval(
            self.residuals,
            groups,
            effective_groups(tested),
            coverage=coverage,
            other_error=float(np.hypot(TEST_ERROR * len(self.residuals) ** -0.5, pooled)),
            share_new=share_new,
        )

    def of(self, target: int) -> Forecast:
        """That of one target."""
        one = slice(target, target + 1)
        return Forecast(
            self.rms[one],
            self.interval[:, one],
            self.baseline[one],
            self.residuals[:, one],
        )

    def in_units(self, unit: Array) -> Forecast:
        """The same where one of a target's present units is so many others."""
        return Forecast(
            self.rms * unit,
            self.interval * unit,
            self.baseline * unit,
            self.residuals * unit,
        )


def forecast_errors(
    X: ArrayLike,
    Y: ArrayLike,
    *,
    groups: ArrayLike | None = None,
    poses: ArrayLike | None = None,
    coverage: float = 0.9,
    n_jobs: int | None = 1,
    max_samples: int = 300,
    max_iter: int = 25,
) -> Forecast:
    """The RMS error that each target will reach on new images, before anything is trained.

    Parameters
    ----------
    X : array of shape (n_samples, n_features)
        Features. Those that were fitted on these very images, above all with their poses, seem
        better than they are: see `forecast_from_folds`.
    Y : array of shape (n_samples, n_targets) or (n_samples,)
    groups : array of shape (n_samples,), optional
        What belongs together and is left out together, such as the blocks of a sequence; 4 groups
        at least. By default each sample is by itself.
    poses : array of shape (n_samples,), optional
        Samples of equal value are repeated shots of one pose, which are left out together and
        count as one. They are found by default (`servoscope.kernels.find_repeats`).
    coverage : float
        Of the interval, 0 to 1.
    max_samples, max_iter : int
        How many samples choose a kernel, and for how long.

    Returns
    -------
    Forecast

    Raises
    ------
    InvalidInputError
        If `X` or `Y` is not finite, there are fewer than 8 samples or 4 groups, or the coverage
        is out of range.

    Notes
    -----
    A Gaussian process predicts every sample from all the others in closed form [1]_. Its length
    scale for each feature, signal and noise are those of largest marginal likelihood on all parts
    of the samples but one, whose residuals count, for each of two to five parts in turn: nothing
    was chosen on the residuals that count. The interval is that of so many residuals, or so many
    groups of them, joined with an error of ``1 / sqrt(n_samples)`` for the training set and the
    kernel being these and no others, as it was found on images. The time grows with the cube of
    the number of samples: 1000 images, 65 features and 6 targets take less than 2 s of one
    processor.

    References
    ----------
    .. [1] C. Rasmussen and C. Williams, "Gaussian processes for machine learning", MIT Press,
       2006, sections 5.4.1 and 5.4.2.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> X = rng.uniform(-1, 1, (300, 2))
    >>> Y = np.column_stack([np.sin(3 * X[:, 0]) + rng.normal(0, 0.1, 300), rng.normal(size=300)])
    >>> forecast = forecast_errors(X, Y)
    >>> forecast.rms.round(1), forecast.explained.round(1)
    (array([0.1, 1. ]), array([1., 0.]))
    """
    check_coverage(coverage)
    features, targets = as_samples(X, Y)
    (features, _), (targets, unit) = in_ordinary_units(features), in_ordinary_units(targets)
    targets = targets - targets[0]  # what never changes is exactly 0
    joined = group_poses(features, targets, check_groups(groups, len(features)), poses)
    parts = cut_samples(len(joined), joined.groups, n_parts(len(joined), max_samples))
    effort = {"max_samples": max_samples, "max_iter": max_iter}
    calls = [
        (joined.X, y, joined.groups, (features, y_shots, joined.members), part, effort)
        for y, y_shots in zip(joined.Y.T, targets.T, strict=True)
        for part in parts
    ]
    residuals = np.empty_like(targets)
    for i, found in enumerate(in_processes(_residuals_of_part, calls, n_jobs)):
        residuals[np.isin(joined.members, parts[i % len(parts)]), i // len(parts)] = found
    return summarise_residuals(residuals, joined, targets, coverage).in_units(unit)


def summarise_residuals(
    residuals: Array, poses: Poses, targets: Array, coverage: float
) -> Forecast:
    """The forecast that residuals of all shots make."""
    groups = poses.groups_of_shots
    return Forecast(
        rms=root_mean_square(residuals),
        interval=rms_interval(residuals, groups, coverage, len(poses) ** -0.5),
        baseline=root_mean_square(_residuals_about_mean(targets, groups)),
        residuals=residuals,
    )


def check_groups(groups: ArrayLike | None, n_samples: int) -> Groups | None:
    """Groups as numbers from 0."""
    if n_samples < LEAST_SAMPLES:
        raise InvalidInputError(
            f"A forecast needs at least {LEAST_SAMPLES} samples, got {n_samples}; take more images."
        )
    if groups is None:
        return None
    values = np.asarray(groups)
    if values.shape != (n_samples,):
        raise InvalidInputError(
            f"groups must be {n_samples} values, one a sample, got the shape {values.shape}."
        )
    names, members = np.unique(values, return_inverse=True)
    if len(names) < LEAST_GROUPS:
        raise InvalidInputError(
            f"A forecast needs at least {LEAST_GROUPS} groups to leave some out, got {len(names)}; "
            "cut the sequence into more blocks."
        )
    return np.asarray(members, dtype=np.intp)


def check_coverage(coverage: float) -> None:
    """Raise InvalidInputError unless a share between 0 and 1 is given."""
    if not 0 < coverage < 1:
        raise InvalidInputError(f"coverage must be between 0 and 1, got {coverage!r}.")


def n_parts(n_samples: int, max_samples: int) -> int:
    """The fewest parts, 2 to 5, of which all but one hold as many samples as choose a kernel."""
    spare = max(n_samples - max_samples, 1)
    return min(max(-(-n_samples // spare), 2), MOST_PARTS)


def cut_samples(n_samples: int, groups: Groups | None, n: int) -> list[NDArray[np.intp]]:
    """Random parts of about equal size that keep groups together.

    Returns
    -------
    list of ndarray
        Indices of the samples in each part, ascending; the same ones each time.
    """
    members = np.arange(n_samples) if groups is None else groups
    order = np.random.default_rng(0).permutation(members.max() + 1)
    pieces = np.array_split(order, min(n, len(order)))
    return [np.flatnonzero(np.isin(members, piece)) for piece in pieces]


def _residuals_of_part(
    X: Array,
    y: Array,
    groups: Groups | None,
    shots: tuple[Array, Array, Groups],
    part: NDArray[np.intp],
    effort: dict[str, int],
) -> Array:
    """Residuals of the shots of some poses under the kernel that is the likeliest on all others."""
    chosen = np.isin(shots[2], part)
    with one_blas_thread():
        kernel = fit_kernel(np.delete(X, part, axis=0), np.delete(y, part), **effort)
        if kernel.signal == 0:
            return shots[1][chosen] - kernel.offset
        if len(X) == len(shots[0]):
            return leave_out_residuals(kernel, X, y, groups)[part]
        counted = shots[0][chosen], shots[1][chosen], shots[2][chosen]
        return shots_left_out(kernel, X, y, groups, counted)


def _residuals_about_mean(targets: Array, groups: Groups | None) -> Array:
    """Targets less their mean over all other samples or groups."""
    if groups is None:
        n = len(targets)
        return (targets - targets.mean(axis=0)) * (n / (n - 1))
    centred = targets - targets.mean(axis=0)
    sums = np.zeros((groups.max() + 1, targets.shape[1]))
    np.add.at(sums, groups, centred)
    sizes = np.bincount(groups)[:, None]
    return np.asarray(centred + (sums / (len(targets) - sizes))[groups])


Indices = NDArray[np.intp]

_LEAST_GAIN = 0.8
"""Nothing is hoped from the samples left out that would lower an error by more than this."""


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
    """The RMS error that each target will reach from features that are fitted to images.

    `forecast_errors` is enough for features that need no fitting. Those fitted to the training
    images, and even more so to their poses, inform more about these images than about new ones.

    Parameters
    ----------
    folds : sequence of Fold
        Of parts from `cut_folds`; they serve for any number of subsets of features.
    Y : array of shape (n_images, n_targets) or (n_images,)
    columns : array of int, optional
        The features that count; all of them by default.
    groups, poses, coverage, n_jobs, max_samples, max_iter
        As of `forecast_errors`.

    Returns
    -------
    Forecast

    Notes
    -----
    Features and kernel are fitted without one part, whose images are then predicted. That is an
    error from fewer images than there are. How much the others are worth is taken from leaving as
    large a share once more out of those that predict: errors fall as a power of the number of
    images, so that equal ratios of images give equal ratios of errors.
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
