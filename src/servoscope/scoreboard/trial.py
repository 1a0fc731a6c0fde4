"""One start: how a method fares, by the simulation, which knows the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import RobotFaultError
from servoscope.poses import displacements_from_poses, inverse_transform, pose_error
from servoscope.positioning import Estimator, LoopSettings, Positioner, PositioningResult
from servoscope.positioning.result import plain
from servoscope.processes import one_blas_thread
from servoscope.robots.registry import SimulatedRobot
from servoscope.scoreboard.cell import CONDITIONS, robot_at_reference, robot_at_start, start_pose

Array = NDArray[np.float64]

SUCCESS_MM, SUCCESS_DEG = 1.0, 0.1
"""A trial has succeeded when the camera ends nearer to the reference than both."""


@dataclass(frozen=True)
class Trial:
    """What became of one start. Errors are those of the camera's true pose.

    Parameters
    ----------
    status, message : str
        How the loop ended, and why.
    moves : int
        That the robot completed.
    path_mm, path_deg : list of float
        Error at every look and, if the robot moved after the last, at the end.
    decisions_ms : list of float
        From each image to the command.
    believed, std, truth : list of 6 floats or None
        Displacement that is left, [m] and [rad] about the pivot in the frame that the robot
        reports: as believed at the end, its believed deviation, and as it is.
    """

    status: str
    message: str
    moves: int
    path_mm: list[float]
    path_deg: list[float]
    decisions_ms: list[float]
    believed: list[float | None]
    std: list[float | None]
    truth: list[float | None]

    @property
    def start_mm(self) -> float:
        """Distance of the start."""
        return self.path_mm[0]

    @property
    def end_mm(self) -> float:
        """Distance at the end."""
        return self.path_mm[-1]

    @property
    def end_deg(self) -> float:
        """Angle at the end."""
        return self.path_deg[-1]

    @property
    def succeeded(self) -> bool:
        """Whether it ended under 1 mm and under 0.1 deg."""
        return self.end_mm < SUCCESS_MM and self.end_deg < SUCCESS_DEG

    @property
    def moves_to_success(self) -> int | None:
        """Moves before the first look from within 1 mm and 0.1 deg."""
        pairs = zip(self.path_mm, self.path_deg, strict=True)
        inside = [mm < SUCCESS_MM and deg < SUCCESS_DEG for mm, deg in pairs]
        return inside.index(True) if any(inside) else None

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON values, from which ``Trial(**values)`` is the same again."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


def run_start(
    scene: str,
    condition: str,
    image_size: int,
    seed: int,
    start: int,
    estimator: Estimator,
    settings: LoopSettings,
) -> Trial:
    """One trial of a method under a condition; a start out of the robot's reach is its fault."""
    reference = robot_at_reference(scene, CONDITIONS[condition].robot, image_size)
    with one_blas_thread():
        try:
            robot = robot_at_start(scene, condition, image_size, seed, start)
        except RobotFaultError as fault:
            changes = CONDITIONS[condition]
            T_world_cam = start_pose(seed, start, changes.factor, changes.dofs)
            return _never_started(str(fault), T_world_cam, reference.true_pose)
        return run_trial(robot, reference, estimator, settings)


def run_trial(
    robot: SimulatedRobot,
    reference: SimulatedRobot,
    estimator: Estimator,
    settings: LoopSettings,
) -> Trial:
    """Let the loop bring a robot to where another stands, and record how it went.

    Interrupted, it raises KeyboardInterrupt: half a trial is none.
    """
    poses: list[Array] = []
    result = Positioner(estimator, settings).run(
        robot, robot, on_step=lambda step, image: poses.append(robot.true_pose)
    )
    if result.status == "interrupted":
        raise KeyboardInterrupt
    if result.moves >= len(poses):
        poses.append(robot.true_pose)
    distance, angle = pose_error(reference.true_pose, np.stack(poses))
    T_cam_told = inverse_transform(reference.true_pose) @ reference.pose
    truth = displacements_from_poses(
        reference.pose, (robot.true_pose @ T_cam_told)[None], estimator.pivot
    )[0]
    return Trial(
        status=result.status,
        message=result.message,
        moves=result.moves,
        path_mm=_rounded(1e3 * distance),
        path_deg=_rounded(np.degrees(angle)),
        decisions_ms=_decisions_ms(result),
        believed=plain(result.remaining),
        std=plain(result.std),
        truth=plain(truth),
    )


def _never_started(message: str, T_world_cam: Array, T_world_ref: Array) -> Trial:
    distance, angle = pose_error(T_world_ref, T_world_cam[None])
    unknown = plain(np.full(6, np.nan))
    path_mm, path_deg = _rounded(1e3 * distance), _rounded(np.degrees(angle))
    return Trial("robot_fault", message, 0, path_mm, path_deg, [], unknown, unknown, unknown)


def _decisions_ms(result: PositioningResult) -> list[float]:
    return [round(1e3 * step.seconds, 3) for step in result.steps if np.isfinite(step.seconds)]


def _rounded(values: Sequence[float] | Array) -> list[float]:
    return [round(float(value), 6) for value in values]
