"""A robot over the user's own part, as far as a keyframe can be seen from elsewhere."""

from __future__ import annotations

from collections.abc import Iterable
from copy import copy
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from servoscope.keyframe import Keyframe
from servoscope.keyframe.camera import CameraModel
from servoscope.keyframe.levels import View, prepare
from servoscope.keyframe.rendering import project
from servoscope.poses import poses_from_displacements
from servoscope.positioning.keyframe_model import KeyframeModel
from servoscope.rehearsal.true_view import OwnErrors, TrueView
from servoscope.robots.free_camera import FreeMotion
from servoscope.robots.registry import LateImages, SimulatedRobot
from servoscope.scene.disturbances import added_noise
from servoscope.scene.lighting import Falloff, Lighting
from servoscope.scene.scene import STANDOFF, T_WORLD_REF, Scene
from servoscope.scoreboard.cell import start_direction, trial_rng
from servoscope.scoreboard.conditions import CONDITIONS, Condition

Array = NDArray[np.float64]

_LEAST = 0.2
_WIDER = 2
_NEAREST, _WHOLLY = 0.05, 0.99


class Backdrop:
    """A plane through the relief, on which the reference image goes on, mirrored at its edges.

    So it moves as a part does when the camera moves, has the texture and the grey levels of the
    view, joins it without an edge, and shows nothing that the keyframe could be aligned with.

    Parameters
    ----------
    keyframe : Keyframe
    width : int
        Of its images, [px].
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
        """The backdrop as other images show it beside the reference view.

        Parameters
        ----------
        images : iterable of (ndarray, ndarray)
            Real images, each with the motion of the camera to where it was taken (4, 4); the
            earlier come first.

        Returns
        -------
        Backdrop
            Still mirrored where none of them shows it.
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

    def render(self, T: Array) -> NDArray[np.uint8]:
        """What is seen of it after a motion of the camera.

        A point ``X`` of the plane has ``n . X = 1`` in the reference camera; the ray ``r`` of a
        camera at ``X' = R X + t`` meets it at ``X' = s r`` with
        ``s = (1 + n . R^T t) / (n . R^T r)``.

        Parameters
        ----------
        T : ndarray of shape (4, 4)
            Reference camera to this camera.
        """
        R, t = T[:3, :3], T[:3, 3]
        slope = self.rays @ (R @ self.plane)
        s = (1 + self.plane @ R.T @ t) / np.maximum(slope, _LEAST * self.plane[2])
        points = ((s[:, None] * self.rays - t) @ R).reshape(*self.view.shape, 3)
        image = sample_at(self._image, self._image_camera, points, cv2.BORDER_REFLECT)
        return np.rint(image).astype(np.uint8)


WIDTH = 128
"""Of the image that light is computed on, [px]."""

FACET = 6.0
"""The relief is smoothed by this before its slopes are found, [px]: it is rougher than the part."""

_N_STEPS = 48
_LONGEST_SHADOW = 0.5
_CLEARANCE = 0.015
_MOST = 3.0


def light_change(
    keyframe: Keyframe, before: Lighting, after: Lighting, azimuth: float
) -> NDArray[np.float32]:
    """How many times brighter each pixel of the reference view is under other lamps.

    The surface is taken to be matt: a lamp of strength s at distance r sheds
    ``s cos(a) / r^2`` where nothing of the relief stands before it.

    Parameters
    ----------
    keyframe : Keyframe
        Its relief is scaled to stand `STANDOFF` before the camera.
    before, after : Lighting
        Over a part that lies in the plane z = 0, [m].
    azimuth : float
        The lamps are turned by this about the vertical, [rad]: where they stand is not known.

    Returns
    -------
    ndarray of shape (height, width), float32
        Of the keyframe's reference image; its mean is that of the change of light.
    """
    view = View.of(keyframe.reference_image, min(WIDTH, keyframe.reference_image.shape[1]), 0.0)
    depth = 1 / cv2.medianBlur(view.resize(keyframe.inverse_depth), 5).astype(float)
    depth *= STANDOFF / float(np.median(depth))
    rays, _ = keyframe.camera.rays(view.points)
    rays = np.column_stack([rays, np.ones(len(rays))]).reshape(*view.shape, 3)
    turn = Rotation.from_euler("z", azimuth).as_matrix()
    to_camera = (T_WORLD_REF[:3, :3].T @ turn, -T_WORLD_REF[:3, :3].T @ T_WORLD_REF[:3, 3])
    surface = _Surface(rays * depth[..., None], depth, keyframe)
    old, new = (surface.radiance(lighting, to_camera) for lighting in (before, after))
    change = np.clip(new / old, 1 / _MOST, _MOST).astype(np.float32)
    height, width = keyframe.reference_image.shape
    return np.asarray(cv2.resize(change, (width, height)), dtype=np.float32)


class _Surface:
    """Points that are seen, shape (rows, columns, 3), in the reference camera, [m]."""

    def __init__(self, points: Array, depth: Array, keyframe: Keyframe) -> None:
        self.points, self.depth = points, depth.astype(np.float32)
        self.camera = keyframe.camera
        smooth = cv2.GaussianBlur(points, (0, 0), FACET, borderType=cv2.BORDER_REPLICATE)
        normals = np.cross(np.gradient(smooth, axis=0), np.gradient(smooth, axis=1))
        normals /= np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-12)
        self.normals = np.where((normals[..., 2] > 0)[..., None], -normals, normals)

    def radiance(self, lighting: Lighting, to_camera: tuple[Array, Array]) -> Array:
        """What a white surface scatters, (rows, columns)."""
        R, t = to_camera
        total = np.full(self.depth.shape, lighting.ambient)
        for lamp in lighting.lamps:
            towards = R @ np.array(lamp.position) + t - self.points
            r = np.linalg.norm(towards, axis=2)
            cosine = np.maximum((self.normals * towards).sum(axis=2) / r, 0)
            lit = self._lit(towards / r[..., None])
            total += lit * lamp.strength * cosine / r**2
        return total

    def _lit(self, towards: Array) -> Array:
        """Where nothing that is seen stands between the surface and a lamp, (rows, columns)."""
        lit = np.ones(self.depth.shape)
        for length in _LONGEST_SHADOW * STANDOFF * (np.arange(_N_STEPS) + 1) / _N_STEPS:
            points = self.points + length * towards
            z = points[..., 2]
            there = sample_at(self.depth, self.camera, points, cv2.BORDER_REPLICATE)
            lit[(z > _NEAREST) & (there < z - _CLEARANCE * STANDOFF)] = 0.0
        return np.asarray(cv2.GaussianBlur(lit, (0, 0), 0.7))


def sample_at(image: NDArray[Any], camera: CameraModel, points: Array, border: int) -> NDArray[Any]:
    """The image where a camera sees points, interpolated.

    Parameters
    ----------
    image : ndarray of shape (height, width)
    camera : CameraModel
        That took it.
    points : ndarray of shape (rows, columns, 3)
        Before the camera, of any scale.
    border : int
        Of OpenCV: how the image goes on beyond its edges, up to its size; points farther off are
        seen there.

    Returns
    -------
    ndarray of shape (rows, columns)

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


_VIEWS = 31
"""What random numbers are drawn for: the views of a rehearsal."""


class RenderedCell(FreeMotion):
    """A robot whose camera sees a `TrueView`; its poses are displacements from the reference.

    Parameters
    ----------
    view : TrueView
    condition : Condition
        Of its robot and of its images; the light is the view's own.
    displacement : array of shape (4, 4)
        Where it starts, exactly, [m].
    noise : float
        Standard deviation of the camera's noise, [grey].
    seed : int
        Draws what covers the view, the same one in every image.
    rng : Generator
        Draws the noise and the errors of motion.
    """

    def __init__(
        self,
        view: TrueView,
        condition: Condition,
        displacement: ArrayLike,
        noise: float,
        seed: int,
        rng: np.random.Generator,
    ) -> None:
        super().__init__(displacement, condition.repeatability, rng)
        self._noise_rng = rng
        self.view, self.condition = view, condition
        self.noise = float(np.hypot(condition.gain * noise, condition.noise))
        self.seed = seed
        self._disturbances = condition.disturbances()

    def read(self) -> NDArray[np.uint8]:
        """The image from where it is."""
        clean = self.view.image(self._reached)
        if self.condition.falloff:
            shaded = Falloff(*self.condition.falloff, seed=self.seed).shade(clean.astype(float))
            clean = np.rint(shaded.clip(0, 255)).astype(np.uint8)
        disturbed = self._disturbances.disturb(clean, np.random.default_rng(self.seed))
        grey = disturbed + added_noise(clean.shape, self.noise, self._noise_rng)
        return np.rint(grey.clip(0, 255)).astype(np.uint8)


def cell_at_start(
    model: KeyframeModel,
    errors: OwnErrors,
    ranges: Array,
    condition: str,
    seed: int,
    start: int,
) -> SimulatedRobot:
    """A robot at a start under a condition, over a view drawn for the start.

    Parameters
    ----------
    model : KeyframeModel
    errors : OwnErrors
        Of its keyframe.
    ranges : ndarray of shape (6,)
        Largest displacement of a start about the pivot at range 1.0, [m] and [rad].
    condition : str
    seed, start : int
        The direction of the start is that of the scoreboard.
    """
    changes, keyframe = CONDITIONS[condition], model.keyframe
    view, azimuth = view_of_start(keyframe, errors, seed, start)
    if any(changes.light_shift):
        trained = Scene()
        after = changes.change(trained, 0).lighting
        view = view.relit(light_change(keyframe, trained.lighting, after, azimuth))
    delta_p = changes.factor * ranges * start_direction(seed, start)
    D = poses_from_displacements(np.eye(4), delta_p, keyframe.pivot)
    rng = trial_rng(seed, condition, start)
    cell = RenderedCell(view, changes, D, keyframe.noise, start + 1000 * seed, rng)
    return LateImages(cell, changes.late) if changes.late else cell


def view_of_start(
    keyframe: Keyframe, errors: OwnErrors, seed: int, start: int
) -> tuple[TrueView, float]:
    """The view that is drawn for a start, and where its lamps stand about the vertical, [rad]."""
    rng = np.random.default_rng([seed, _VIEWS, start])
    return TrueView.draw(keyframe, errors, rng), float(rng.uniform(-np.pi, np.pi))


def cell_at_reference(model: KeyframeModel) -> SimulatedRobot:
    """A robot that stands at the reference and is not moved."""
    view = TrueView(model.keyframe, np.zeros(6))
    rng = np.random.default_rng(0)
    return RenderedCell(view, Condition(), np.eye(4), model.keyframe.noise, 0, rng)
