"""A robot over the user's own part, as far as a keyframe can be seen from elsewhere."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from servoscope.keyframe import Keyframe
from servoscope.keyframe.levels import View
from servoscope.poses import poses_from_displacements
from servoscope.positioning.keyframe_model import KeyframeModel
from servoscope.rehearsal.true_view import OwnErrors, TrueView, sample_at
from servoscope.robots.free_camera import FreeMotion
from servoscope.robots.registry import LateImages, SimulatedRobot
from servoscope.scene.disturbances import added_noise
from servoscope.scene.lighting import Falloff, Lighting
from servoscope.scene.scene import STANDOFF, T_WORLD_REF, Scene
from servoscope.scoreboard.cell import CONDITIONS, Condition, start_direction, trial_rng

Array = NDArray[np.float64]

WIDTH = 128
"""Of the image that light is computed on, [px]."""

FACET = 6.0
"""The relief is smoothed by this before its slopes are found, [px]: it is rougher than the part."""

_N_STEPS = 48
_LONGEST_SHADOW = 0.5
_CLEARANCE, _NEAREST = 0.015, 0.05
_MOST = 3.0


def light_change(
    keyframe: Keyframe, before: Lighting, after: Lighting, azimuth: float
) -> NDArray[np.float32]:
    """How many times brighter each pixel of the reference view is under other lamps, float32.

    The relief is scaled to stand `STANDOFF` before the camera, over a plane z = 0, and its surface
    taken to be matt: a lamp of strength s at distance r sheds ``s cos(a) / r^2`` where nothing of
    the relief stands before it. Where the lamps stand is not known: they are turned by an azimuth,
    [rad]. The mean over the pixels is that of the change of light.
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


_VIEWS = 31
"""What random numbers are drawn for: the views of a rehearsal."""


class RenderedCell(FreeMotion):
    """A robot whose camera sees a `TrueView`; its poses are displacements from the reference.

    The light is the view's own, all else that of the condition. The seed draws what covers the
    view, the same in every image, `rng` the noise and the errors of motion.
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
        self._seen: tuple[Array, Array] | None = None

    def read(self) -> NDArray[np.uint8]:
        """The image from where it is."""
        if self._seen is None or self._seen[0] is not self._reached:
            self._seen = self._reached, self._grey()
        grey = self._seen[1] + added_noise(self._seen[1].shape, self.noise, self._noise_rng)
        return np.rint(grey.clip(0, 255)).astype(np.uint8)

    def _grey(self) -> Array:
        """What is seen from where it is, but for the noise."""
        clean = self.view.image(self._reached)
        if self.condition.falloff:
            clean = np.asarray(Falloff(*self.condition.falloff, seed=self.seed).shade(clean))
        rng = np.random.default_rng(self.seed)
        return np.asarray(self._disturbances.disturb_grey(clean, rng))


def cell_at_start(
    model: KeyframeModel,
    errors: OwnErrors,
    ranges: Array,
    condition: str,
    seed: int,
    start: int,
) -> SimulatedRobot:
    """A robot at a start of the scoreboard under a condition, over a view drawn for the start from
    the errors of the model's keyframe. `ranges` are the largest displacements about the pivot at
    range 1.0.
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
