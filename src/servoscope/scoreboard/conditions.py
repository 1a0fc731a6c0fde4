"""What is changed under the methods: how the trials differ from the images they were made for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from servoscope.poses import DOFS
from servoscope.robots.free_camera import Repeatability
from servoscope.scene.camera import Covering
from servoscope.scene.cylinder_head import CylinderHead
from servoscope.scene.disturbances import (
    Disturbances,
    amplified,
    defocused,
    noisier,
    with_lamp_moved,
)
from servoscope.scene.lighting import Falloff
from servoscope.scene.scene import Scene

SCENES = ("cylinder_head", "textured_plane")

LIGHT_SHIFT = (-0.3, 0.0, 0.0)
"""Where the first lamp is moved, along the part towards the chain case, [m]."""

REPAINTED = 0.05
"""Share of the plane that is another in the other casting; two heads differ by more than 10 grey
levels in as much of their images."""


_EXACT = Repeatability()


def _same_part(scene: Scene) -> Scene:
    return scene


def _other_casting(scene: Scene) -> Scene:
    if isinstance(scene.part, CylinderHead):
        return replace(scene, part=replace(scene.part, variant=scene.part.variant + 1))
    return replace(scene, part=replace(scene.part, repainted=REPAINTED))


@dataclass(frozen=True)
class Condition:
    """How trials differ from the images that the methods were made for.

    What the strengths mean stands in `servoscope.scene.disturbances`; they are the same for a
    simulated scene (`change`) and for images (`disturbances`).

    Parameters
    ----------
    gain : float
        Of the sensor, as a factor.
    defocus : float
        [px of 256].
    noise : float
        On top of the sensor's own, [grey].
    covering : float
        Share of the view behind a rectangle of one grey.
    light_shift : tuple of 3 floats
        How far the first lamp is moved, [m].
    falloff : tuple of 2 floats, optional
        Factors of the light at its brightest and darkest across the view.
    part : callable
        Makes of the scene of training one with another part.
    factor : float
        The starts are drawn from this many times the range.
    robot : {"free", "arm"}
        What carries the camera, in training too.
    repeatability : Repeatability
        How far from where it is sent the robot comes to rest in a trial.
    late : int
        How many reads old the images of a trial are.
    depth_factor : float
        The depth that the baseline is given, relative to the truth.
    dofs : tuple of str
        The degrees of freedom that the robot has, in training too.
    """

    gain: float = 1.0
    defocus: float = 0.0
    noise: float = 0.0
    covering: float = 0.0
    light_shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    falloff: tuple[float, float] | None = None
    part: Callable[[Scene], Scene] = _same_part
    factor: float = 1.0
    robot: str = "free"
    repeatability: Repeatability = _EXACT
    late: int = 0
    depth_factor: float = 1.0
    dofs: tuple[str, ...] = DOFS

    @property
    def is_for_baseline_alone(self) -> bool:
        """Whether nothing is different but the depth that the baseline is given."""
        return replace(self, depth_factor=1.0) == CONDITIONS["range_1.0"]

    @property
    def is_of_images(self) -> bool:
        """Whether it can be made of images of the part and needs no scene: see `disturbances`."""
        as_trained = replace(self, part=_same_part, robot="free", depth_factor=1.0, dofs=DOFS)
        return self == as_trained

    def change(self, scene: Scene, number: int) -> Scene:
        """The scene of a start, made of that of training, given a number of the start's own."""
        sensor = noisier(defocused(amplified(scene.sensor, self.gain), self.defocus), self.noise)
        changed = replace(self.part(scene), sensor=sensor)
        if self.covering:
            changed = replace(changed, covering=Covering(self.covering, seed=number))
        if self.falloff:
            changed = replace(changed, falloff=Falloff(*self.falloff, seed=number))
        if any(self.light_shift):
            changed = replace(changed, lighting=with_lamp_moved(scene.lighting, self.light_shift))
        return changed

    def disturbances(self) -> Disturbances:
        """What the condition makes of an image, but for its light and its noise."""
        strengths = {"gain": self.gain, "defocus": self.defocus, "covering": self.covering}
        return Disturbances.only(**strengths)


CONDITIONS = {
    "range_0.4": Condition(factor=0.4),
    "range_1.0": Condition(),
    "range_1.5": Condition(factor=1.5),
    "gain_0.8": Condition(gain=0.8),
    "gain_0.95": Condition(gain=0.95),
    "light_moved": Condition(light_shift=LIGHT_SHIFT),
    "covered_10": Condition(covering=0.10),
    "covered_20": Condition(covering=0.20),
    "noise_10": Condition(noise=10.0),
    "defocus": Condition(defocus=2.0),
    "depth_0.6": Condition(depth_factor=0.6),
    "depth_1.5": Condition(depth_factor=1.5),
    "other_casting": Condition(part=_other_casting),
    "repeatability": Condition(repeatability=Repeatability(5e-5, float(np.radians(0.01)))),
    "arm": Condition(robot="arm"),
    "stale_frames": Condition(late=1),
    "light_falloff": Condition(falloff=(1.15, 0.7)),
    "planar": Condition(dofs=("tx", "ty", "rz")),
}
"""Every condition, by name. ``gain`` turns down the sensor; ``noise_10`` adds noise of ten grey
levels; ``defocus`` blurs by two pixels of 256 more (`servoscope.scene.disturbances`);
``repeatability`` is 0.05 mm and 0.01 deg a move; the images of ``stale_frames`` are one read
old; ``light_falloff`` multiplies the light by 1.15 on one side of the view and 0.7 on the other;
the robot of ``planar`` moves along x and y and about z alone, in training too."""
