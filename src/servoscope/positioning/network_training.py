"""Training of the networks for positioning: features measured, ranked, and networks compared."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from servoscope.data.splits import Split
from servoscope.errors import InvalidInputError
from servoscope.pipeline import FeatureTable, Fitted, Recipe, fit_all
from servoscope.poses import DISPLAY_FACTORS, DOFS
from servoscope.positioning.feature_subsets import Subsets, rank_paper, rank_wide
from servoscope.positioning.holding_up import LARGEST_SHARE, disturbance_shares
from servoscope.positioning.linear_features import FeaturePool
from servoscope.positioning.network_samples import Samples, measure_samples, one_a_row
from servoscope.positioning.pose_networks import PoseNetworks
from servoscope.regression import LMRegressor, PoseRegressor
from servoscope.scene.disturbances import SINGLE_DISTURBANCES, Disturbances

Array = NDArray[np.float64]
Progress = Callable[[int], object]

LEAST_IMAGES = 40
PAPER_NETWORK = LMRegressor(hidden=30, restarts=3)
WIDE_NETWORK = LMRegressor(hidden=30, restarts=1, patience=5, weight_decay=1.0)


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
    pool, samples = measure_samples(images, scaled, disturbances, seed, n_jobs, on_progress)
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
        (rank_paper, PAPER_NETWORK) if disturbances is None else (rank_wide, WIDE_NETWORK)
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
        "left_out": _left_out(pool, shares, holds),
        "validation_rms": _errors(regressor, samples, used, ranges),
    }
    return PoseNetworks(pool.only(pool.names[c] for c in used), regressor, ranges, facts)


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
        one_a_row(samples.train, samples.train_delta_p),
        one_a_row(samples.validation, samples.validation_delta_p),
    )
    jobs = [
        (_recipe(subset, network, zlib.crc32(f"{seed} {dof} {subset}".encode())), dof)
        for dof in DOFS
        for subset in subsets[dof]
    ]
    X, Y = (np.concatenate(parts) for parts in zip(train, validation, strict=True))
    n_train, n_all = len(train[0]), len(X)
    trained = fit_all(
        FeatureTable(X, tuple(map(str, range(X.shape[1]))), ("pool",) * X.shape[1]),
        Y,
        Split(np.arange(n_train), np.arange(n_train, n_all), np.arange(0)),
        jobs,
        poses=np.arange(n_all),  # disturbed copies of an image are there to differ
        n_jobs=n_jobs,
        on_progress=on_progress,
    )
    best: dict[str, Fitted] = {}
    for one in trained:
        if one.dof not in best or one.validation_rms < best[one.dof].validation_rms:
            best[one.dof] = one
    nets = {dof: one.regressor for dof, one in best.items()}
    return nets, {dof: one.columns for dof, one in best.items()}


def _recipe(subset: Sequence[int], network: LMRegressor, seed: int) -> Recipe:
    return Recipe("pool", tuple(map(str, subset)), network, {"random_state": seed})


def _left_out(
    pool: FeaturePool, shares: Array, holds: NDArray[np.bool_]
) -> dict[str, dict[str, float | None]]:
    """Shares of the features that do not hold up; None where the pose changes nothing."""
    return {
        pool.names[i]: {
            name: round(float(share), 3) if np.isfinite(share) else None
            for name, share in zip(SINGLE_DISTURBANCES, shares[i], strict=True)
        }
        for i in np.flatnonzero(~holds)
    }


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
