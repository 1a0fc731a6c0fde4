"""From images with poses to a keyframe: mount, plane, relief, and all of them together."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from servoscope.keyframe.adjustment import LEAST_INVERSE_DEPTH, Adjustment, Priors, Solution, State
from servoscope.keyframe.camera import CameraModel
from servoscope.keyframe.levels import View, correlation, spread_rotations
from servoscope.keyframe.motion import conjugate
from servoscope.keyframe.relief import semi_global_labels, sweep_costs
from servoscope.poses import inverse_transform, rigid_transform

Array = NDArray[np.float64]
Images = NDArray[np.uint8]

FINEST = 128
"""Width at which the relief is fitted, [px]."""

MOST_IMAGES = 60
"""Most images that are adjusted together."""

FOCAL_LENGTHS = (0.5, 0.8, 1.3, 2.1)
"""Focal lengths that are tried where none is given, [image widths]."""

_N_ROTATIONS = 500
_N_NEAREST = 10
_N_STARTS = 12
_LEAST_SHIFT = 0.2
_RELIEF_LEVELS = ((64, 1.0, 48), (96, 1.0, 32), (FINEST, 1.0, 24))
_WIDE, _NARROW = (0.5, 1.8), (0.85, 1.15)
_EDGE = 10.0
_LEAST_DEPTH = 1e-3


@dataclass(frozen=True, eq=False)
class Known:
    """What need not be found.

    Parameters
    ----------
    camera : CameraModel, optional
    mount : ndarray of shape (4, 4), optional
        Where to begin; its turn is not searched.
    distance : float
        Of the part from the camera, to begin with, [m].
    """

    camera: CameraModel | None = None
    mount: Array | None = None
    distance: float = 0.55


def view_shifts(displacements: Array, distance: float) -> Array:
    """By how much displacements move what is seen, roughly, [rad]."""
    shift = np.linalg.norm(displacements[:, :3, 3], axis=1) / distance
    return shift + Rotation.from_matrix(displacements[:, :3, :3]).magnitude()


def chosen_images(displacements: Array, distance: float) -> NDArray[np.intp]:
    """The images that are adjusted, nearest first: all, or `MOST_IMAGES`, most of them far."""
    shifts = view_shifts(displacements, distance)
    order = np.argsort(shifts, kind="stable")
    if len(order) <= MOST_IMAGES:
        return order
    is_far = shifts[order] > 0.5 * shifts.max()
    far = evenly_spread(order[is_far], MOST_IMAGES * 3 // 4)
    near = evenly_spread(order[~is_far], MOST_IMAGES - len(far))
    return np.concatenate([near, far])


def evenly_spread(indices: NDArray[np.intp], n: int) -> NDArray[np.intp]:
    """At most n of the indices, evenly spread."""
    return indices[np.linspace(0, len(indices) - 1, min(n, len(indices))).round().astype(int)]


def fit_state(
    images: Images, displacements: Array, reference_image: Images, known: Known, priors: Priors
) -> Solution:
    """The state that explains the images, which are sorted nearest first."""
    shifts = view_shifts(displacements, known.distance)
    n_near = int(np.count_nonzero(shifts < _LEAST_SHIFT * shifts.max()))
    first = min(n_near, len(images) // 2)
    few = slice(first, first + _N_NEAREST)
    state = find_mount(images[few], displacements[few], reference_image, known, priors)
    state = replace(
        state,
        corrections=np.tile(np.eye(4), (len(images), 1, 1)),
        light=np.tile([1.0, 0.0, 0.0, 0.0], (len(images), 1)),
    )
    for width, sigma in ((48, 1.2), (64, 1.0)):
        adjustment = _adjustment(images, displacements, reference_image, width, sigma, priors)
        solution = adjustment.run(state, 8, poses=False)
        state = solution.state
    reach = _WIDE
    for width, sigma, n_labels in _RELIEF_LEVELS:
        adjustment = _adjustment(images, displacements, reference_image, width, sigma, priors)
        state = sweep(adjustment, solution, reach, n_labels)
        state = adjustment.run(state, 3, poses=False).state
        solution = adjustment.run(state, 6, relief=True)
        reach = _NARROW
    return solution


def turning_state(
    state: State,
    lever: Array,
    images: Images,
    displacements: Array,
    reference_image: Images,
    priors: Priors,
) -> Solution:
    """The state that explains the images by rotations of the camera alone.

    Where no translation is seen, a lever between the camera and what turns it cannot be separated
    from a longer focal length, so that it is held.

    Parameters
    ----------
    state : State
        That `fit_state` has found.
    lever : ndarray of shape (3,)
        Translation of the mount, [m].
    """
    mount = rigid_transform(state.mount[:3, :3], lever)
    state = replace(state, mount=mount, relief=np.full((2, 2), LEAST_INVERSE_DEPTH))
    held = replace(priors, mount=(0.0, priors.mount[1]))
    width, sigma, _ = _RELIEF_LEVELS[-1]
    return _adjustment(images, displacements, reference_image, width, sigma, held).run(state, 10)


def find_mount(
    images: Images, displacements: Array, reference_image: Images, known: Known, priors: Priors
) -> State:
    """Camera, mount and a plane from the nearest images at low resolution, from many starts."""
    adjustment = _adjustment(images, displacements, reference_image, 32, 1.5, priors)
    cameras = [CameraModel(f) for f in FOCAL_LENGTHS] if known.camera is None else [known.camera]
    mounts = (
        [known.mount]
        if known.mount is not None
        else [rigid_transform(R, np.zeros(3)) for R in spread_rotations(_N_ROTATIONS)]
    )
    view, n = adjustment.view, len(images)
    grey = view.grey.ravel()
    plane = np.full(len(grey), 1 / known.distance, np.float32)
    scores, starts = [], []
    for camera in cameras:
        rays = camera.rays(view.points)[0].astype(np.float32)
        for mount in mounts:
            T = inverse_transform(conjugate(mount, displacements))
            scores.append(
                sum(
                    correlation(image, T[k], camera.values, view.aspect, rays, plane, grey)
                    for k, image in enumerate(adjustment.images)
                )
            )
            starts.append((camera, mount))
    solutions = []
    for k in np.argsort(scores, kind="stable")[::-1][:_N_STARTS]:
        camera, mount = starts[k]
        state = State.start(camera, mount, n, 1 / known.distance)
        solutions.append(adjustment.run(state, 8, poses=False))
    return min(solutions, key=lambda solution: solution.cost).state


def sweep(
    adjustment: Adjustment, solution: Solution, reach: tuple[float, float], n_labels: int
) -> State:
    """The state with the relief that a plane sweep finds, between shares of the one it has."""
    state, view = solution.state, adjustment.view
    before = view.resize(state.relief)
    low, high = reach
    spread = np.linspace(low - 1, high - 1, n_labels)[:, None] * float(np.median(before))
    labels = np.maximum(before.ravel() + spread, _LEAST_DEPTH).astype(np.float32)
    costs = sweep_costs(
        adjustment.images,
        state.transforms(adjustment.displacements),
        state.camera.values,
        view.aspect,
        view.points.astype(np.float32),
        state.camera.rays(view.points)[0].astype(np.float32),
        labels,
        view.grey.ravel(),
        state.light,
        np.maximum(solution.scales, 1.0),
    )
    best = semi_global_labels(costs.reshape(*view.shape, n_labels), view.grey, _EDGE).ravel()
    below = np.minimum(best.astype(int), n_labels - 2)
    pixels = np.arange(len(best))
    part = best - below
    relief = (1 - part) * labels[below, pixels] + part * labels[below + 1, pixels]
    return replace(state, relief=relief.reshape(view.shape))


def _adjustment(
    images: Images,
    displacements: Array,
    reference_image: Images,
    width: int,
    sigma: float,
    priors: Priors,
) -> Adjustment:
    view = View.of(reference_image, width, sigma)
    prepared = np.stack([view.prepare(image) for image in images])
    return Adjustment(view, prepared, displacements, priors)
