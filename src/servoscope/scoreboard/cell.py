"""The simulated cell of a trial: what the camera looks at, where it starts, what carries it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from servoscope.dofs import mask_of
from servoscope.poses import DOFS, inverse_transform, poses_from_displacements
from servoscope.robots.registry import LateImages, SimulatedRobot, make_robot
from servoscope.scene.render import prepare
from servoscope.scene.scene import T_WORLD_REF, Scene, make_part
from servoscope.scoreboard.conditions import CONDITIONS

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
        reference = make_robot(robot, trained)
        T_reported_cam = inverse_transform(reference.pose) @ reference.true_pose
    T_world_cam = start_pose(seed, start, changes.factor, dofs, pivot, T_reported_cam)
    rng = trial_rng(seed, condition, start)
    made = make_robot(robot, seen, changes.repeatability, rng, T_world_cam)
    prepare(seen)
    return LateImages(made, changes.late) if changes.late else made


def robot_at_reference(scene: str, robot: str, image_size: int) -> SimulatedRobot:
    """An exact robot with its camera at the reference, over the part of training."""
    return make_robot(robot, scene_of_training(scene, image_size))
