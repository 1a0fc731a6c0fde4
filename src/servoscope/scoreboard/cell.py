"""The conditions of a trial and its simulated cell: what is seen, from where, what carries it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from servoscope.dofs import mask_of
from servoscope.poses import DOFS, inverse_transform, poses_from_displacements
from servoscope.robots.free_camera import Repeatability
from servoscope.robots.registry import LateImages, SimulatedRobot, make_robot
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
from servoscope.scene.render import prepare
from servoscope.scene.scene import T_WORLD_REF, Scene, make_part

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


Array = NDArray[np.float64]

PIVOT = 0.55
"""Distance from the camera of the point that starts are turned about, [m]."""

RANGES = np.array([0.025] * 3 + [np.radians(15.0)] * 3)
"""Largest displacement of a start at range 1.0, [m] and [rad]."""
RANGES.setflags(write=False)

_STARTS, _TRIALS = 20, 21
"""What random numbers are drawn for; those of acquisitions are numbered from 0."""


def scene_of_training(part: str, image_size: int, variant: int = 0) -> Scene:
    """The scene that the methods are made for."""
    return Scene(part=make_part(part, variant), image_size=image_size)


def start_direction(seed: int, start: int) -> Array:
    """Displacement of a start in shares of the range, (6,), each from -1 to 1."""
    return np.random.default_rng([seed, _STARTS, start]).uniform(-1.0, 1.0, 6)


def start_pose(
    seed: int,
    start: int,
    factor: float,
    dofs: tuple[str, ...] = DOFS,
    pivot: float = PIVOT,
    T_reported_cam: Array | None = None,
) -> Array:
    """``T_world_cam`` of a start, (4, 4), [m]:

    the same direction for every factor of the range. It is displaced in some dofs about the pivot,
    in the axes of the frame that is reported.
    """
    T_reported_cam = np.eye(4) if T_reported_cam is None else T_reported_cam
    delta_p = factor * RANGES * start_direction(seed, start) * mask_of(dofs)
    along_z = float((T_reported_cam @ [0.0, 0.0, pivot, 1.0])[2])
    T_world_reported = T_WORLD_REF @ inverse_transform(T_reported_cam)
    return poses_from_displacements(T_world_reported, delta_p, along_z) @ T_reported_cam


def trial_rng(seed: int, condition: str, start: int) -> np.random.Generator:
    """Draws the noise and the errors of motion of a trial."""
    return np.random.default_rng([seed, _TRIALS, list(CONDITIONS).index(condition), start])


def robot_at_start(
    scene: str, condition: str, image_size: int, seed: int, start: int
) -> SimulatedRobot:
    """A robot with its camera at a start, under a condition.

    Its noise and its errors of motion are the same for every method.
    """
    robot = CONDITIONS[condition].robot
    return robot_in_cell(scene, 0, robot, condition, image_size, seed, start)


def robot_in_cell(
    part: str,
    variant: int,
    robot: str,
    condition: str,
    image_size: int,
    seed: int,
    start: int = 0,
    dofs: tuple[str, ...] | None = None,
    pivot: float = PIVOT,
) -> SimulatedRobot:
    """A robot over a part, with its camera at a start, under all of a condition but its robot.

    Its first image takes no longer than the others: the scene is prepared here. The start is
    displaced in some dofs about a pivot, see `start_pose`, by default in those of the condition: of
    the frame that the robot reports if they are not all six.
    """
    changes = CONDITIONS[condition]
    trained = scene_of_training(part, image_size, variant)
    seen = changes.change(trained, start + 1000 * seed)
    dofs, T_reported_cam = dofs or changes.dofs, None
    if dofs != DOFS:
        T_reported_cam = mount_of(make_robot(robot, trained))
    T_world_cam = start_pose(seed, start, changes.factor, dofs, pivot, T_reported_cam)
    rng = trial_rng(seed, condition, start)
    made = make_robot(robot, seen, changes.repeatability, rng, T_world_cam)
    prepare(seen)
    return LateImages(made, changes.late) if changes.late else made


def robot_at_reference(scene: str, robot: str, image_size: int) -> SimulatedRobot:
    """An exact robot with its camera at the reference, over the part of training."""
    return make_robot(robot, scene_of_training(scene, image_size))


def mount_of(reference: SimulatedRobot) -> Array:
    """Where the camera is in the frame that a robot without errors reports, (4, 4), [m]."""
    return inverse_transform(reference.pose) @ reference.true_pose
