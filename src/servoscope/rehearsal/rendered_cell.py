"""A robot over the user's own part, as far as a keyframe can be seen from elsewhere."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.keyframe import Keyframe
from servoscope.poses import poses_from_displacements
from servoscope.positioning.keyframe_model import KeyframeModel
from servoscope.rehearsal.relighting import light_change
from servoscope.rehearsal.true_view import OwnErrors, TrueView
from servoscope.robots.free_camera import FreeMotion
from servoscope.robots.registry import LateImages, SimulatedRobot
from servoscope.scene.disturbances import added_noise
from servoscope.scene.lighting import Falloff
from servoscope.scene.scene import Scene
from servoscope.scoreboard.cell import start_direction, trial_rng
from servoscope.scoreboard.conditions import CONDITIONS, Condition

Array = NDArray[np.float64]

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
