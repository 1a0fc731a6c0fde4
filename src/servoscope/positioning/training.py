"""Training a model for positioning."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.dataset import PoseImageSet
from servoscope.errors import DataSetError, InvalidInputError, ServoscopeWarning
from servoscope.poses import DISPLAY_FACTORS, DOFS, displacements_from_poses
from servoscope.positioning.disturbances import Disturbances
from servoscope.positioning.keyframe_model import KeyframeModel, error_shares
from servoscope.positioning.ladder import HeldOut, has_images_for_levels, learn_levels
from servoscope.positioning.model import PositioningModel
from servoscope.positioning.pose_networks import PoseNetworks
from servoscope.processes import one_blas_thread

Array = NDArray[np.float64]

METHODS = ("auto", "keyframe", "levels")

N_STAGES = 3
"""Stages of training that progress is told of: levels, networks, and what they reach."""

LEAST_GAIN = 0.8
"""A dof is observable if its error is at most this share of that of predicting the mean."""

_OUTER = 0.3
_MOST_CHECKED = 40
_LEAST_OUTER = 10


def train(
    data: PoseImageSet,
    *,
    method: str = "auto",
    seed: int = 0,
    n_jobs: int | None = -1,
    on_progress: Callable[[int], object] | None = None,
) -> PositioningModel | KeyframeModel:
    """A model that reads where images were taken.

    Parameters
    ----------
    data : PoseImageSet
        Best taken in rings around the reference, see ``servoscope acquire --schedule``. Its poses
        may be the flange's: where the camera sits need not be known.
    method : {"auto", "keyframe", "levels"}
        Fit a keyframe, which takes 15 to 60 images, or learn levels and networks, which take
        hundreds in rings; by default whatever the images are enough for, levels first.
    seed : int
        Draws the nets' starts, what is held out, and the disturbances.
    n_jobs : int, optional
        Processes, as joblib counts them; the model does not depend on it.
    on_progress : callable, optional
        Called with the number of stages, of `N_STAGES`, that are finished.

    Returns
    -------
    PositioningModel or KeyframeModel

    Raises
    ------
    DataSetError
        If there are too few images, a dof never moves, or most dofs of images held out are
        predicted no better than by their mean.

    Warns
    -----
    ServoscopeWarning
        If some dofs of images held out are predicted no better than by their mean.
    """
    if not data.moves().all():
        raise DataSetError(
            "Training for positioning needs images displaced along and about every axis, but "
            "some dofs never move in this data set; take images with all six displaced."
        )
    if method not in METHODS:
        raise InvalidInputError(f"method must be one of {', '.join(METHODS)}, got {method!r}.")
    reach, delta_p = data.ranges(), data.delta_p()
    p = delta_p / reach
    if method == "keyframe" or (method == "auto" and not has_images_for_levels(p)):
        keyframe = KeyframeModel.train(data, n_jobs=n_jobs, on_progress=on_progress)
        check_observable(keyframe.accuracy["error_shares"])
        return keyframe
    tell = on_progress or (lambda _: None)
    rng = np.random.default_rng([seed, len(data)])
    with one_blas_thread():
        levels, held_out = learn_levels(data.images, p, data.reference_image, rng)
        tell(1)
        outer = np.abs(p).max(axis=1) > _OUTER
        networks = PoseNetworks.train(
            data.images[outer],
            delta_p[outer],
            reach,
            disturbances=Disturbances(),
            seed=seed,
            n_jobs=n_jobs,
        )
        tell(2)
        model = PositioningModel(
            networks, levels, data.reference_image, data.pivot, reach, dict(data.source)
        )
        model.accuracy.update(_measure(model, held_out))
    check_observable(model.accuracy["error_shares"])
    tell(3)
    return model


def check_observable(error_shares: Mapping[str, float]) -> None:
    """Say which dofs a model cannot predict, or refuse one that is of no use.

    Parameters
    ----------
    error_shares : mapping of str to float
        By dof: RMS error of images held out, as a share of that of their mean.

    Raises
    ------
    DataSetError
        If most dofs are predicted no better than by the mean.

    Warns
    -----
    ServoscopeWarning
        If some are.
    """
    unobservable = [dof for dof, share in error_shares.items() if not share < LEAST_GAIN]
    if not unobservable:
        return
    shown = ", ".join(f"{dof} {error_shares[dof]:.2f}" for dof in unobservable)
    found = (
        f"Images held out are predicted hardly better than by their mean in {shown} (error as a "
        f"share of the mean's, at most {LEAST_GAIN:g})"
    )
    advice = "see that every image belongs to its pose, none late, and that it shows the part"
    if 2 * len(unobservable) > len(error_shares):
        raise DataSetError(f"{found}; no robot may be moved by that: {advice}.")
    warnings.warn(
        f"{found}; the robot will not be positioned in these dofs: {advice}.",
        ServoscopeWarning,
        stacklevel=3,
    )


def _measure(model: PositioningModel, held_out: HeldOut) -> dict[str, Any]:
    """Median absolute error of one look, in mm and degrees, by how far away the camera is."""
    size = np.abs(held_out.p).max(axis=1)
    outer = np.flatnonzero(size > _OUTER)
    outer = outer if len(outer) >= _LEAST_OUTER else np.arange(len(size))
    shares = _error_shares(model, held_out.images[outer], held_out.p[outer])
    rings = []
    for level in model.levels:
        near = np.flatnonzero((size <= level.radius) & (size > level.radius / 2))[:_MOST_CHECKED]
        if not near.size:
            continue
        ring: dict[str, Any] = {
            "mm": 1e3 * level.radius * float(model.reach[:3].max()),
            "deg": float(np.degrees(level.radius * model.reach[3:].max())),
            "n_images": int(near.size),
        }
        for kind, images in (("clean", held_out.images), ("disturbed", held_out.disturbed)):
            errors = _errors(model, images[near], held_out.p[near])
            ring[kind] = dict(zip(DOFS, np.median(errors, axis=0).tolist(), strict=True))
        rings.append(ring)
    return {
        "rings": rings,
        "error_shares": dict(zip(DOFS, shares.tolist(), strict=True)),
        "networks": model.networks.report(),
    }


def _error_shares(model: PositioningModel, images: NDArray[np.uint8], p: Array) -> Array:
    """RMS errors of first looks as shares of those of predicting the mean, (6,)."""
    truth = p * model.reach * DISPLAY_FACTORS
    return error_shares(_errors(model, images, p), truth)


def _errors(model: PositioningModel, images: NDArray[np.uint8], p: Array) -> Array:
    """Absolute errors of first looks, (n, 6), [mm] and [deg]."""
    said = np.stack([model.estimate(image).displacement for image in images])
    delta_p = displacements_from_poses(np.eye(4), said, model.pivot)
    return np.abs(delta_p - p * model.reach) * DISPLAY_FACTORS
