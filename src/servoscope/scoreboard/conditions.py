"""What is changed under the methods: how the trials differ from the images they were made for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from servoscope.robots.free_camera import Repeatability
from servoscope.scene.covering import Covering
from servoscope.scene.part import CylinderHead
from servoscope.scene.scene import Scene
from servoscope.scene.sensor import Sensor
from servoscope.scene.strengths import amplified, defocused, noisier

SCENES = ("cylinder_head", "textured_plane")

LIGHT_SHIFT = (-0.3, 0.0, 0.0)
"""Where the first lamp is moved, along the part towards the chain case, [m]."""

REPAINTED = 0.05
"""Share of the plane that is another in the other casting; two heads differ by more than 10 grey
levels in as much of their images."""

_EXACT = Repeatability()

Change = Callable[[Scene, int], Scene]
"""Makes of the scene of training the scene of a start, given a number of the start's own."""


def _as_trained(scene: Scene, number: int) -> Scene:
    return scene


@dataclass(frozen=True)
class Condition:
    """How trials differ from the images that the methods were made for.

    Parameters
    ----------
    change : callable
        What is different in the scene.
    factor : float
        The starts are drawn from this many times the range.
    robot : {"free", "arm"}
        What carries the camera, in training too.
    repeatability : Repeatability
        How far from where it is sent the robot comes to rest in a trial.
    depth_factor : float
        What the baseline is told of the depth, relative to the truth.
    """

    change: Change = _as_trained
    factor: float = 1.0
    robot: str = "free"
    repeatability: Repeatability = _EXACT
    depth_factor: float = 1.0

    @property
    def is_for_baseline_alone(self) -> bool:
        """Whether nothing is different but what the baseline is told."""
        return replace(self, depth_factor=1.0) == CONDITIONS["range_1.0"]


def _sensor(change: Callable[[Sensor, float], Sensor], strength: float) -> Change:
    return lambda scene, number: replace(scene, sensor=change(scene.sensor, strength))


def _covered(share: float) -> Change:
    return lambda scene, number: replace(scene, covering=Covering(share, seed=number))


def _light_moved(scene: Scene, number: int) -> Scene:
    first, *others = scene.lighting.lamps
    x, y, z = np.add(first.position, LIGHT_SHIFT).tolist()
    lamps = (replace(first, position=(x, y, z)), *others)
    return replace(scene, lighting=replace(scene.lighting, lamps=lamps))


def _other_casting(scene: Scene, number: int) -> Scene:
    if isinstance(scene.part, CylinderHead):
        return replace(scene, part=replace(scene.part, variant=scene.part.variant + 1))
    return replace(scene, part=replace(scene.part, repainted=REPAINTED))


CONDITIONS = {
    "range_0.4": Condition(factor=0.4),
    "range_1.0": Condition(),
    "range_1.5": Condition(factor=1.5),
    "gain_0.8": Condition(_sensor(amplified, 0.8)),
    "gain_0.95": Condition(_sensor(amplified, 0.95)),
    "light_moved": Condition(_light_moved),
    "covered_10": Condition(_covered(0.10)),
    "covered_20": Condition(_covered(0.20)),
    "noise_10": Condition(_sensor(noisier, 10.0)),
    "defocus": Condition(_sensor(defocused, 2.0)),
    "depth_0.6": Condition(depth_factor=0.6),
    "depth_1.5": Condition(depth_factor=1.5),
    "other_casting": Condition(_other_casting),
    "repeatability": Condition(repeatability=Repeatability(5e-5, float(np.radians(0.01)))),
    "arm": Condition(robot="arm"),
}
"""Every condition, by name. ``gain`` turns down the sensor; ``noise_10`` adds noise of ten grey
levels; ``defocus`` blurs by two pixels of 256 more (`servoscope.scene.strengths`);
``repeatability`` is 0.05 mm and 0.01 deg a move."""
