"""Features of the images that train the networks for positioning, and of those kept back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from servoscope.kernels import find_repeats
from servoscope.positioning.candidate_features import (
    NORMALISED_PREPARATIONS,
    PAPER_PREPARATIONS,
    fit_paper_pool,
    fit_wide_pool,
)
from servoscope.positioning.linear_features import FeaturePool
from servoscope.positioning.training_copies import prepare_copies
from servoscope.processes import one_blas_thread
from servoscope.scene.disturbances import SINGLE_DISTURBANCES, Disturbances

Array = NDArray[np.float64]

VALIDATION_SHARE = 0.2
N_COPIES = 2


@dataclass(frozen=True, eq=False)
class Samples:
    """Features of training and validation images and of their copies.

    ``train`` is of shape (n, 1 + n_copies, n_features), ``validation`` too, and ``single`` of
    shape (n_validation, n_single, n_features); displacements are in units of the range.
    """

    train: Array
    train_delta_p: Array
    validation: Array
    validation_delta_p: Array
    single: Array


def measure_samples(
    images: NDArray[np.uint8],
    delta_p: Array,
    disturbances: Disturbances | None,
    seed: int,
    n_jobs: int | None,
    on_progress: Callable[[int], object],
) -> tuple[FeaturePool, Samples]:
    """The pool that the training images give, and its features."""
    poses = find_repeats(delta_p, delta_p)
    order = np.random.default_rng([seed, 1]).permutation(poses.max() + 1)
    validates = np.isin(poses, order[: round(VALIDATION_SHARE * len(order))])
    validation, train = np.flatnonzero(validates), np.flatnonzero(~validates)
    copies: list[Disturbances | None] = [None]
    preparations: tuple[str, ...] = PAPER_PREPARATIONS
    if disturbances is not None:
        copies += [disturbances] * N_COPIES
        preparations += NORMALISED_PREPARATIONS
    prepared = prepare_copies(
        images[train], copies, preparations, seed=seed, n_jobs=n_jobs, on_progress=on_progress
    )
    held_out = prepare_copies(
        images[validation],
        [*copies, *SINGLE_DISTURBANCES.values()],
        preparations,
        seed=seed + 1,
        n_jobs=n_jobs,
        on_progress=lambda n: on_progress(len(train) + n),
    )
    fit = fit_paper_pool if disturbances is None else fit_wide_pool
    pool, n = fit(prepared, delta_p[train]), len(copies)
    with one_blas_thread():
        values, kept = pool.compute(prepared), pool.compute(held_out)
    samples = Samples(values, delta_p[train], kept[:, :n], delta_p[validation], kept[:, n:])
    return pool, samples


def one_a_row(values: Array, delta_p: Array) -> tuple[Array, Array]:
    """Samples one a row, with the displacement of each."""
    n_copies, n_features = values.shape[1:]
    return values.reshape(-1, n_features), np.repeat(delta_p, n_copies, axis=0)
