"""Many networks trained side by side, in processes of one BLAS thread each."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.arrays import as_numbers, check_scale
from servoscope.errors import InvalidInputError
from servoscope.processes import in_processes
from servoscope.regression.samples import Samples, Shots, group_shots, least_deviation
from servoscope.regression.tanh_network import Array
from servoscope.regression.training import TrainedNetwork, rms_left_out, train_restarts

if TYPE_CHECKING:
    from servoscope.regression.network import LMRegressor

Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class NetworkJob:
    """One network to train.

    Parameters
    ----------
    columns : array of int
        Columns of X that are its inputs.
    target : int
        Column of Y that it learns.
    seed : int
        Draws its starts.
    """

    columns: NDArray[np.intp]
    target: int
    seed: int = 0


def train_networks(
    X: ArrayLike,
    Y: ArrayLike,
    jobs: Sequence[NetworkJob],
    train: ArrayLike,
    validation: ArrayLike | None = None,
    *,
    regressor: LMRegressor | None = None,
    n_jobs: int | None = None,
    on_progress: Callable[[int], object] | None = None,
    poses: ArrayLike | None = None,
) -> Iterator[LMRegressor]:
    """Train a network for every job; yields them in the order of the jobs.

    Parameters
    ----------
    X : array of shape (n_samples, n_features)
    Y : array of shape (n_samples, n_targets)
    jobs : sequence of NetworkJob
    train, validation : arrays of int
        Rows that train, and rows that stop the training.
    regressor : LMRegressor, optional
        Gives the parameters; its `random_state` gives way to the seed of each job.
    n_jobs : int, optional
        Number of processes, as joblib understands it; one by default.
    on_progress : callable, optional
        Called with the number of networks trained so far.
    poses : array of shape (n_samples,), optional
        Samples of equal value are repeated shots of one pose, which train as one sample, their
        mean. By default they are found (`servoscope.kernels.find_repeats`).

    Yields
    ------
    LMRegressor
        Fitted; the same bit for bit for any number of processes.

    Raises
    ------
    InvalidInputError
        If the arrays disagree, hold NaN or infinity or values beyond 1e30, a job names a column
        they do not have, or less than two rows train.

    Examples
    --------
    >>> X = np.random.default_rng(0).normal(size=(100, 3))
    >>> jobs = [NetworkJob(np.array([0, 1]), 0), NetworkJob(np.array([2]), 0)]
    >>> nets = train_networks(X, X[:, :1] * X[:, 1:2], jobs, range(80), range(80, 100))
    >>> [net.n_features_in_ for net in nets]
    [2, 1]
    """
    from servoscope.regression.network import LMRegressor

    samples = _check_samples(X, Y, jobs)
    held_out = None if validation is None else _check_rows(validation, len(samples[0]))
    rows = _check_rows(train, len(samples[0]))
    if len(rows) < 2:
        raise InvalidInputError(f"At least two rows must train, got {len(rows)}.")
    samples, parts = _by_poses(samples, rows, held_out, poses)
    template = LMRegressor() if regressor is None else regressor
    options = [template.training_options(job.seed) for job in jobs]
    networks = _train_all(samples, jobs, parts, options, n_jobs)
    return _adopt_all(networks, jobs, template, on_progress)


def _by_poses(
    samples: tuple[Array, Array],
    train: Indices,
    held_out: Indices | None,
    poses: ArrayLike | None,
) -> tuple[tuple[Array, Array], tuple[Any, Any]]:
    """Samples in which the repeated shots of a pose that trains are one, their mean."""
    X, Y = samples
    validation = None if held_out is None else Samples(X[held_out], Y[held_out])
    if poses is not None:
        poses = np.asarray(poses)[train if held_out is None else np.append(train, held_out)]
    learned, others = group_shots(Samples(X[train], Y[train]), validation, poses)
    if learned.poses is learned.each and len(learned.each.y) == len(train):
        return samples, (train, held_out)
    n = len(learned.poses.y)
    X, Y = learned.poses.joined(None if others is None else others.each)
    return (X, Y), (np.arange(n), None if others is None else np.arange(n, len(Y)))


def _adopt_all(
    networks: Iterator[TrainedNetwork],
    jobs: Sequence[NetworkJob],
    template: LMRegressor,
    on_progress: Callable[[int], object] | None,
) -> Iterator[LMRegressor]:
    from sklearn.base import clone

    for n_done, (job, network) in enumerate(zip(jobs, networks, strict=True), start=1):
        if on_progress is not None:
            on_progress(n_done)
        yield clone(template).set_params(random_state=job.seed).adopt(network)


def _train_all(
    samples: tuple[Array, Array],
    jobs: Sequence[NetworkJob],
    parts: tuple[Any, Any],
    options: Sequence[dict[str, Any]],
    n_jobs: int | None,
) -> Iterator[TrainedNetwork]:
    calls = ((*samples, *parts, job, option) for job, option in zip(jobs, options, strict=True))
    return in_processes(_train_one, calls, n_jobs, batch_size=1)


def _train_one(
    X: Array, Y: Array, train: Any, validation: Any, job: NetworkJob, options: dict[str, Any]
) -> TrainedNetwork:
    Z, y = X[:, job.columns], Y[:, job.target]
    if validation is not None:
        return train_restarts(Z[train], y[train], Z[validation], y[validation], **options)
    samples = Samples(Z[train], y[train])
    network = train_restarts(*samples, None, None, **options)
    shots = Shots(samples, samples, np.arange(len(samples.y)))
    return replace(network, error=rms_left_out(shots, options) or least_deviation(samples.y))


def _check_samples(X: ArrayLike, Y: ArrayLike, jobs: Sequence[NetworkJob]) -> tuple[Array, Array]:
    X, Y = as_numbers(X, "X"), as_numbers(Y, "Y")
    if X.ndim != 2 or Y.ndim != 2 or len(X) != len(Y):
        raise InvalidInputError(
            "X and Y must be of shape (n_samples, n_features) and (n_samples, n_targets), "
            f"got {X.shape} and {Y.shape}."
        )
    if not (np.isfinite(X).all() and np.isfinite(Y).all()):
        raise InvalidInputError("X and Y must be finite, but hold NaN or infinity.")
    if X.size and Y.size:
        check_scale(X, "X")
        check_scale(Y, "Y")
    for job in jobs:
        columns = np.asarray(job.columns)
        if not _are_places(columns, X.shape[1]):
            raise InvalidInputError(
                f"A job must name columns from 0 to {X.shape[1] - 1}, got {columns.tolist()}."
            )
        if not 0 <= job.target < Y.shape[1]:
            raise InvalidInputError(
                f"A job's target must be from 0 to {Y.shape[1] - 1}, got {job.target}."
            )
    return X, Y


def _are_places(indices: NDArray[Any], n: int) -> bool:
    """Whether there are any, all from 0 to n - 1."""
    is_any = indices.dtype.kind in "iu" and indices.size > 0
    return is_any and 0 <= indices.min() <= indices.max() < n


def _check_rows(rows: ArrayLike, n_samples: int) -> NDArray[np.intp]:
    rows = np.asarray(rows)
    if not _are_places(rows, n_samples):
        raise InvalidInputError(
            f"The rows that train and stop the training must be from 0 to {n_samples - 1}, at "
            f"least one of each, got {rows.size} rows."
        )
    return rows
