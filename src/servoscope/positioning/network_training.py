"""Training of the networks for positioning: features measured, ranked, and networks compared."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import InvalidInputError
from servoscope.poses import DISPLAY_FACTORS, DOFS
from servoscope.positioning.candidate_features import (
    NORMALISED_PREPARATIONS,
    PAPER_PREPARATIONS,
    fit_paper_pool,
    fit_wide_pool,
)
from servoscope.positioning.disturbances import SINGLE_DISTURBANCES, Disturbances
from servoscope.positioning.holding_up import LARGEST_SHARE, disturbance_shares
from servoscope.positioning.linear_features import FeaturePool
from servoscope.positioning.pose_networks import PoseNetworks
from servoscope.positioning.training_copies import prepare_copies
from servoscope.regression import LMRegressor, NetworkJob, PoseRegressor, train_networks
from servoscope.selection import (
    mutual_information,
    pairwise_mutual_information,
    rank_ideal_point,
    threshold_subsets,
)

Array = NDArray[np.float64]
Progress = Callable[[int], object]
Subsets = dict[str, list[tuple[int, ...]]]

VALIDATION_SHARE = 0.2
LEAST_IMAGES = 40
N_COPIES = 2
N_MOMENTS, N_RANKED, N_MOST_RELEVANT = 24, 24, (24, 40)
PAPER_NETWORK = LMRegressor(hidden=30, restarts=3)
WIDE_NETWORK = LMRegressor(hidden=30, restarts=1, patience=5, weight_decay=1.0)


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


def train_pose_networks(
    images: NDArray[np.uint8],
    delta_p: Array,
    ranges: Array,
    disturbances: Disturbances | None,
    seed: int,
    n_jobs: int | None,
    on_progress: Progress | None,
) -> PoseNetworks:
    """See `PoseNetworks.train`."""
    _check(images, delta_p, ranges)
    on_progress = on_progress or (lambda _: None)
    scaled, ranges = delta_p / ranges, np.asarray(ranges, dtype=np.float64)
    pool, samples = _measure(images, scaled, disturbances, seed, n_jobs, on_progress)
    shares = disturbance_shares(samples.validation[:, 0], samples.single)
    holds = np.ones(len(pool.names), dtype=bool)
    if disturbances is not None:
        holds = shares.max(axis=1) <= LARGEST_SHARE
    if not holds.any():
        raise InvalidInputError(
            "No feature holds up against the disturbances; train on images in which the part is "
            "seen, or without disturbances."
        )
    rank, network = (
        (_rank_paper, PAPER_NETWORK) if disturbances is None else (_rank_wide, WIDE_NETWORK)
    )
    subsets = rank(pool, samples, holds)
    nets, columns = _train(
        samples, subsets, network, seed, n_jobs, lambda n: on_progress(len(images) + n)
    )
    used = sorted({int(column) for chosen in columns.values() for column in chosen})
    place = {column: i for i, column in enumerate(used)}
    regressor = PoseRegressor.from_fitted(
        nets, {dof: [place[int(c)] for c in chosen] for dof, chosen in columns.items()}, len(used)
    )
    facts = {
        "features": {dof: [pool.names[c] for c in chosen] for dof, chosen in columns.items()},
        "largest_share": LARGEST_SHARE if disturbances is not None else None,
        "left_out": {
            pool.names[i]: dict(zip(SINGLE_DISTURBANCES, shares[i].round(3).tolist(), strict=True))
            for i in np.flatnonzero(~holds)
        },
        "validation_rms": _errors(regressor, samples, used, ranges),
    }
    return PoseNetworks(pool.only(pool.names[c] for c in used), regressor, ranges, facts)


def _measure(
    images: NDArray[np.uint8],
    delta_p: Array,
    disturbances: Disturbances | None,
    seed: int,
    n_jobs: int | None,
    on_progress: Progress,
) -> tuple[FeaturePool, Samples]:
    """The pool that the training images give, and its features."""
    order = np.random.default_rng([seed, 1]).permutation(len(images))
    n_validation = round(VALIDATION_SHARE * len(images))
    validation, train = np.sort(order[:n_validation]), np.sort(order[n_validation:])
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
    pool = fit(prepared, delta_p[train])
    values = pool.compute(held_out)
    n = len(copies)
    samples = Samples(
        pool.compute(prepared), delta_p[train], values[:, :n], delta_p[validation], values[:, n:]
    )
    return pool, samples


def _rank_paper(pool: FeaturePool, samples: Samples, _: NDArray[np.bool_]) -> Subsets:
    """The paper's subsets of each dof's features: those above each threshold, and the moments.

    The first are its tables II and III, the moments alone the best family of its table I.
    """
    X, Y = _flat(samples.train, samples.train_delta_p)
    relevance, pairwise = mutual_information(X, Y), pairwise_mutual_information(X)
    subsets = {}
    for i, dof in enumerate(DOFS):
        ranking = rank_ideal_point(relevance[:, i], pairwise, N_RANKED)
        found = threshold_subsets(ranking.order, ranking.relevance)
        subsets[dof] = [tuple(range(N_MOMENTS)), *(subset.features for subset in found)]
    return subsets


def _rank_wide(pool: FeaturePool, samples: Samples, holds: NDArray[np.bool_]) -> Subsets:
    """The features that tell most of a dof, and the pose vectors next to the one that does.

    Here redundancy does not count: where images are disturbed, features that tell the same make
    up for each other. By the ideal-point rule errors were a third larger.
    """
    relevance = mutual_information(*_flat(samples.train, samples.train_delta_p))
    relevance[~holds] = -1.0
    subsets = {}
    for i, dof in enumerate(DOFS):
        order = np.argsort(-relevance[:, i], kind="stable")[: np.count_nonzero(holds)]
        found = [tuple(order[:n].tolist()) for n in N_MOST_RELEVANT]
        if vectors := [c for c in order if "_pose_" in pool.names[c]]:
            family = pool.names[vectors[0]].split("_pose_")[0] + "_pose_"
            found.append(tuple(int(c) for c in vectors if pool.names[c].startswith(family)))
        subsets[dof] = list(dict.fromkeys(found))
    return subsets


def _train(
    samples: Samples,
    subsets: Subsets,
    network: LMRegressor,
    seed: int,
    n_jobs: int | None,
    on_progress: Progress,
) -> tuple[dict[str, LMRegressor], dict[str, NDArray[np.intp]]]:
    """The best network of each dof on validation images, and its columns."""
    train, validation = (
        _flat(samples.train, samples.train_delta_p),
        _flat(samples.validation, samples.validation_delta_p),
    )
    jobs = [
        NetworkJob(np.array(subset), i, zlib.crc32(f"{seed} {dof} {subset}".encode()))
        for i, dof in enumerate(DOFS)
        for subset in subsets[dof]
    ]
    n_train, n_all = len(train[0]), len(train[0]) + len(validation[0])
    trained = train_networks(
        np.concatenate([train[0], validation[0]]),
        np.concatenate([train[1], validation[1]]),
        jobs,
        np.arange(n_train),
        np.arange(n_train, n_all),
        regressor=network,
        n_jobs=n_jobs,
        on_progress=on_progress,
    )
    best: dict[str, tuple[NetworkJob, LMRegressor]] = {}
    for job, net in zip(jobs, trained, strict=True):
        dof = DOFS[job.target]
        if dof not in best or net.result_.best_rms < best[dof][1].result_.best_rms:
            best[dof] = job, net
    nets = {dof: net for dof, (_, net) in best.items()}
    return nets, {dof: job.columns for dof, (job, _) in best.items()}


def _flat(values: Array, delta_p: Array) -> tuple[Array, Array]:
    """Samples one a row, with the displacement of each."""
    n_copies, n_features = values.shape[1:]
    return values.reshape(-1, n_features), np.repeat(delta_p, n_copies, axis=0)


def _errors(
    regressor: PoseRegressor, samples: Samples, used: Sequence[int], ranges: Array
) -> dict[str, list[float]]:
    """RMS errors on validation images, undisturbed and disturbed, [mm] and [deg]."""

    def rms(values: Array) -> list[float]:
        error = regressor.predict(values[:, used]) - samples.validation_delta_p
        return (np.sqrt(np.mean(error**2, axis=0)) * ranges * DISPLAY_FACTORS).round(4).tolist()

    errors = {"clean": rms(samples.validation[:, 0])}
    for i, name in enumerate(SINGLE_DISTURBANCES):
        errors[name] = rms(samples.single[:, i])
    return errors


def _check(images: NDArray[np.uint8], delta_p: Array, ranges: Array) -> None:
    if images.ndim != 3 or images.dtype != np.uint8 or len(images) < LEAST_IMAGES:
        raise InvalidInputError(
            f"Networks are trained on {LEAST_IMAGES} or more uint8 images of shape "
            f"(n, height, width), got {images.dtype} of shape {images.shape}."
        )
    if np.shape(delta_p) != (len(images), len(DOFS)) or np.shape(ranges) != (len(DOFS),):
        raise InvalidInputError(
            f"delta_p and ranges must be of shape ({len(images)}, 6) and (6,), got "
            f"{np.shape(delta_p)} and {np.shape(ranges)}."
        )
    if not np.isfinite(delta_p).all() or not (np.asarray(ranges) > 0).all():
        raise InvalidInputError("delta_p must be finite and ranges positive, but one is not.")
