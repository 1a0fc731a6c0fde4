"""The view as it may really be: what a keyframe shows, with errors as large as its own."""

from __future__ import annotations

from collections.abc import Iterable
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from servoscope.errors import ModelError
from servoscope.keyframe import Keyframe
from servoscope.keyframe.camera import CameraModel
from servoscope.keyframe.fitting import view_shifts
from servoscope.keyframe.levels import View, prepare
from servoscope.keyframe.motion import conjugate
from servoscope.keyframe.rendering import project
from servoscope.poses import (
    DISPLAY_FACTORS,
    DOFS,
    displacements_from_poses,
    inverse_transform,
    poses_from_displacements,
)
from servoscope.positioning.keyframe_model import KeyframeModel

Array = NDArray[np.float64]

WIDEST = 256
"""Width that views are rendered at; wider images are enlarged from it, [px]."""

_CORRELATED = 3.0
_MOST_RELIEF = 0.05
_SHOWN = 3
_NORMAL_MEDIAN = 0.6745


_LEAST = 0.2
_WIDER = 2
_NEAREST, _WHOLLY = 0.05, 0.99


class Backdrop:
    """A plane through the relief, on which the reference image goes on, mirrored at its edges.

    So it moves as a part does when the camera moves, has the texture and the grey levels of the
    view, joins it without an edge, and shows nothing that the keyframe could be aligned with.
    """

    def __init__(self, keyframe: Keyframe, width: int) -> None:
        self.camera = keyframe.camera
        self.view = View.of(keyframe.reference_image, width, 0.0)
        rays, _ = self.camera.rays(self.view.points)
        self.rays = np.column_stack([rays, np.ones(len(rays))])
        depth = self.view.resize(keyframe.inverse_depth).ravel().astype(float)
        trust = self.view.resize(keyframe.trust).ravel().astype(float) + 1e-3
        rows = np.sqrt(trust)[:, None]
        self.plane = np.linalg.lstsq(self.rays * rows, depth * rows[:, 0], rcond=None)[0]
        self._image, self._image_camera = self.view.grey, self.camera

    def shown_in(self, images: Iterable[tuple[NDArray[Any], Array]]) -> Backdrop:
        """The backdrop as other images show it beside the reference view, mirrored where none does.

        Each comes with the motion of the camera to where it was taken (4, 4); the earlier come
        first.
        """
        height, width = self.view.shape
        f, cx, cy = self.camera.values[:3] / _WIDER
        wide = CameraModel(f, cx, cy)
        canvas = View.of(np.zeros((_WIDER * height, _WIDER * width)), _WIDER * width, 0.0)
        rays = np.column_stack([wide.rays(canvas.points)[0], np.ones(len(canvas.points))])
        slope = np.maximum(rays @ self.plane, _LEAST * self.plane[2])
        points = rays / slope[:, None]
        mirrored = points.reshape(*canvas.shape, 3)
        grey = sample_at(self.view.grey, self.camera, mirrored, cv2.BORDER_REFLECT)
        unknown = np.ones(canvas.shape, bool)
        for image, T in ((self.view.grey, np.eye(4)), *images):
            at = (points @ T[:3, :3].T + T[:3, 3]).reshape(*canvas.shape, 3)
            small = prepare(image, width, 0.0)
            shown = sample_at(np.ones_like(small), self.camera, at, cv2.BORDER_CONSTANT) > _WHOLLY
            shown &= unknown & (at[..., 2] > _NEAREST)
            grey[shown] = sample_at(small, self.camera, at, cv2.BORDER_CONSTANT)[shown]
            unknown &= ~shown
        other = copy(self)
        other._image, other._image_camera = grey, wide
        return other

    def render(self, T: Array) -> Array:
        """Grey levels that are seen of it after a motion of the camera, from the reference camera
        to this.

        A point ``X`` of the plane has ``n . X = 1`` in the reference camera; the ray ``r`` of a
        camera at ``X' = R X + t`` meets it at ``X' = s r`` with ``s = (1 + n . R^T t) / (n . R^T
        r)``.
        """
        R, t = T[:3, :3], T[:3, 3]
        slope = self.rays @ (R @ self.plane)
        s = (1 + self.plane @ R.T @ t) / np.maximum(slope, _LEAST * self.plane[2])
        points = ((s[:, None] * self.rays - t) @ R).reshape(*self.view.shape, 3)
        return sample_at(self._image, self._image_camera, points, cv2.BORDER_REFLECT)


def sample_at(image: NDArray[Any], camera: CameraModel, points: Array, border: int) -> NDArray[Any]:
    """The image where the camera that took it sees points (rows, columns, 3), interpolated.

    `border`, of OpenCV, says how the image goes on beyond its edges, up to its size; points farther
    off are seen there.

    Examples
    --------
    A point on the axis is seen in the middle, between the four pixels of a small image:

    >>> image = np.array([[0.0, 2.0], [4.0, 6.0]])
    >>> sample_at(image, CameraModel(1.0), np.array([[[0.0, 0.0, 3.0]]]), cv2.BORDER_REFLECT)
    array([[3.]])
    """
    shape, (height, width) = points.shape[:2], image.shape
    flat = points.reshape(-1, 3)
    z = np.maximum(flat[:, 2], 1e-3)
    seen = np.empty(flat.shape)
    project(np.eye(4), camera.values, height / width, flat[:, :2] / z[:, None], 1 / z, seen)
    column = _pixels((seen[:, 0] + 0.5) * width - 0.5, width).reshape(shape)
    row = _pixels((seen[:, 1] * width / height + 0.5) * height - 0.5, height).reshape(shape)
    return np.asarray(cv2.remap(image, column, row, cv2.INTER_LINEAR, borderMode=border))


def _pixels(at: Array, size: int) -> NDArray[np.float32]:
    """Finite and not far away: OpenCV walks back from there, one image after the other."""
    near = np.clip(np.nan_to_num(at), -size, 2 * size)
    return np.asarray(near, dtype=np.float32)


@dataclass(frozen=True)
class OwnErrors:
    """How far a keyframe is from the truth.

    Parameters
    ----------
    reading : ndarray of shape (6,)
        Standard deviation of what is read of each dof about the pivot, per radian that the view is
        shifted.
    relief : float
        Standard deviation of its inverse depths where the images agree least, relative.
    grey : float
        Standard deviation of the noise of its reference image, [grey].
    """

    reading: Array
    relief: float
    grey: float = 0.0

    @classmethod
    def of(cls, model: KeyframeModel) -> OwnErrors:
        """As the images that were held out and the residuals of those that were fitted show.

        The relief is as wrong as it must be for the residual of the fitted images that noise does
        not explain.

        Raises
        ------
        ModelError
            If the model's median errors are not one number, 0 or more, for each of its dofs.
        """
        keyframe = model.keyframe
        reading = keyframe.model_error
        if "median" in model.accuracy:
            median = _by_dof(model.accuracy["median"], model.dofs) / DISPLAY_FACTORS
            shift = float(np.median(shifts(keyframe, keyframe.displacements)))
            reading = np.maximum(reading, median / _NORMAL_MEDIAN / max(shift, 1e-3))
        return cls(reading, relief_error(keyframe), reference_noise(model))


def reference_noise(model: KeyframeModel) -> float:
    """Standard deviation of the noise of the reference image, [grey].

    It is the mean of as many images as the source of the data says, or else one image.
    """
    n = model.trained_on.get("n_reference_images")
    return model.keyframe.noise / float(np.sqrt(n if isinstance(n, int) and n > 0 else 1))


def _by_dof(values: Any, dofs: tuple[str, ...]) -> Array:
    """Six numbers by the names of the dofs; 0 for those that there are not."""
    try:
        array = np.array([float(values[dof]) if dof in dofs else 0.0 for dof in DOFS])
    except (LookupError, TypeError, ValueError):
        array = np.full(6, np.nan)
    if not (np.isfinite(array) & (array >= 0)).all():
        raise ModelError(
            f"The median errors of a model must be numbers named {', '.join(dofs)}, got "
            f"{str(values)[:80]!r}; train it again."
        )
    return array


def shifts(keyframe: Keyframe, displacements: Array) -> Array:
    """By how much displacements move what is seen, roughly, [rad], shape (n,)."""
    moved = np.stack([conjugate(keyframe.mount, D) for D in displacements])
    return view_shifts(moved, 1 / float(np.median(keyframe.inverse_depth)))


def relief_error(keyframe: Keyframe) -> float:
    """Relative standard deviation of inverse depths that explains the fitted images' residual."""
    view = View.of(keyframe.reference_image, min(128, keyframe.reference_image.shape[1]), 1.0)
    rng = np.random.default_rng(0)
    noise = view.prepare(rng.normal(0, keyframe.noise, keyframe.reference_image.shape))
    wanted = float(np.sqrt(max(keyframe.residual**2 - float(noise.var()), 0.0)))
    order = np.argsort(shifts(keyframe, keyframe.displacements), kind="stable")
    shown = keyframe.displacements[
        order[np.linspace(0, len(order) - 1, _SHOWN + 2).astype(int)[1:-1]]
    ]
    clean = [keyframe.render(D, view.width) for D in shown]
    errors = [_relief_field(keyframe, rng) for _ in shown]

    def excess(deviation: float) -> float:
        squares = []
        for D, field, (image, known) in zip(shown, errors, clean, strict=True):
            off = replace(keyframe, inverse_depth=keyframe.inverse_depth * (1 + deviation * field))
            other, also_known = off.render(D, view.width)
            seen = known & also_known
            r = cv2.GaussianBlur(image.astype(float) - other, (0, 0), 1.0)[seen]
            squares.append(np.mean(r**2 / (1 + (r / (3 * max(wanted, 0.5))) ** 2)))
        return float(np.sqrt(np.mean(squares))) - wanted

    if excess(0.0) >= 0:
        return 0.0
    if excess(_MOST_RELIEF) <= 0:
        return _MOST_RELIEF
    return float(brentq(excess, 0.0, _MOST_RELIEF, xtol=1e-3, rtol=0.05))


def _relief_field(keyframe: Keyframe, rng: np.random.Generator) -> NDArray[np.float32]:
    """A smooth random field over the relief, of deviation 1 where the images agree least."""
    field = cv2.GaussianBlur(rng.standard_normal(keyframe.trust.shape), (0, 0), _CORRELATED)
    return np.asarray(field / field.std() * (1.1 - keyframe.trust) / 1.1, dtype=np.float32)


@dataclass(frozen=True, eq=False)
class TrueView:
    """What a camera may see of the part that a keyframe is of.

    A keyframe explains the images that are rendered of it perfectly, which no real image is. So
    its relief is changed, and what is seen at a displacement is rendered at another one, off by
    errors like those of reading images that were held out; both vanish at the reference. Its
    reference image has the noise of a real one.

    Parameters
    ----------
    keyframe : Keyframe
        With a relief and a light of its own.
    misreading : ndarray of shape (6,)
        How far off the displacement is that images are rendered at, per radian that the view is
        shifted, about the pivot, [m] and [rad].
    backdrop : Backdrop, optional
        What is seen beside the keyframe; one of its own by default.
    """

    keyframe: Keyframe
    misreading: Array
    backdrop: Backdrop | None = None

    @classmethod
    def draw(cls, keyframe: Keyframe, errors: OwnErrors, rng: np.random.Generator) -> TrueView:
        """A view with errors of those sizes, drawn at random."""
        field = errors.relief * _relief_field(keyframe, rng)
        relief = np.asarray(keyframe.inverse_depth * (1 + field), dtype=np.float32)
        misreading, shape = errors.reading * rng.standard_normal(6), keyframe.reference_image.shape
        grey = keyframe.reference_image + errors.grey * rng.standard_normal(shape)
        reference = np.rint(grey.clip(0, 255)).astype(np.uint8)
        keyframe = replace(keyframe, inverse_depth=relief, reference_image=reference)
        return cls(keyframe, misreading)

    def relit(self, change: NDArray[np.float32]) -> TrueView:
        """The view with each pixel of the reference so many times as bright."""
        grey = np.clip(np.rint(self.keyframe.reference_image * change), 0, 255)
        return replace(self, keyframe=replace(self.keyframe, reference_image=grey.astype(np.uint8)))

    @cached_property
    def _backdrop(self) -> Backdrop:
        return self.backdrop or Backdrop(
            self.keyframe, min(WIDEST, self.keyframe.reference_image.shape[1])
        )

    def image(self, displacement: Array) -> Array:
        """Grey levels seen at a displacement (4, 4), [m], without noise, (height, width).

        Where the keyframe does not know what is there, the `Backdrop` is seen.
        """
        keyframe, pivot = self.keyframe, self.keyframe.pivot
        (delta_p,) = displacements_from_poses(np.eye(4), displacement[None], pivot)
        shift = shifts(keyframe, displacement[None])[0]
        D = poses_from_displacements(np.eye(4), delta_p + shift * self.misreading, pivot)
        seen, known = keyframe.render_grey(D, self._backdrop.view.width)
        beside = self._backdrop.render(inverse_transform(conjugate(keyframe.mount, D)))
        image = np.where(known, seen, beside)
        height, width = keyframe.reference_image.shape
        if image.shape != (height, width):
            image = cv2.resize(image, (width, height), interpolation=cv2.INTER_CUBIC)
        return np.asarray(image, dtype=np.float64)
