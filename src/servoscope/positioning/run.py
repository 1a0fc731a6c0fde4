"""One run of the loop, until there is a reason to end it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import NoReturn

import numpy as np

from servoscope.poses import displacements_from_poses, inverse_transform
from servoscope.positioning import guard
from servoscope.positioning.arrival import is_noise_only, is_within_tolerance
from servoscope.positioning.devices import RunEnded, WatchedCamera, WatchedRobot, one_line
from servoscope.positioning.guard import as_text
from servoscope.positioning.image_error import image_error, reference_thumbnail, thumbnail
from servoscope.positioning.interfaces import Array, Camera, Estimate, Estimator, Image, Robot
from servoscope.positioning.result import PositioningResult, Step
from servoscope.positioning.settings import LoopSettings

OnStep = Callable[[Step, Image], object]

_RETURNING = ("diverged", "max_moves")


class Run:
    """One run of the loop, and what it has seen and done so far.

    Parameters
    ----------
    estimator : Estimator
    settings : LoopSettings
    robot : Robot
    camera : Camera
    on_step : callable or None
        Called with each step and its image before the robot moves.
    """

    def __init__(
        self,
        estimator: Estimator,
        settings: LoopSettings,
        robot: Robot,
        camera: Camera,
        on_step: OnStep | None,
    ) -> None:
        self.estimator = estimator
        self.settings = settings
        self.robot = WatchedRobot(robot, settings)
        self.camera = WatchedCamera(camera, estimator.image_shape, settings)
        self.on_step = on_step
        self.reference = reference_thumbnail(estimator.reference_image)
        self.steps: list[Step] = []
        self.returned_to: int | None = None
        self.is_moving = False
        self._last_change: tuple[Image, Array] | None = None

    def approach(self, dry_run: bool) -> NoReturn:
        """Look and move until `RunEnded` says why no longer."""
        try:
            while True:
                commanded = self._look()
                if dry_run:
                    raise RunEnded("max_moves", _dry_run_message(commanded))
                executed = self._move(commanded)
                self.steps[-1] = replace(self.steps[-1], executed=executed)
        except RunEnded as end:
            if end.status in _RETURNING and not dry_run:
                self._return_to_best()
            raise

    def result(self, status: str, message: str) -> PositioningResult:
        """The run so far, ended with a status."""
        if self.returned_to is not None:
            message += f" The robot went back to the best pose seen, look {self.returned_to + 1}."
        remaining, std = self._belief()
        return PositioningResult(
            status, message, self.robot.moves, remaining, std, tuple(self.steps), self.returned_to
        )

    def _look(self) -> Array:
        """Take an image and decide; what comes back is the move to make."""
        pose = self.robot.pose
        image = self.camera.read()
        start = time.perf_counter()
        self._check_image(image, pose)
        error = image_error(thumbnail(image), self.reference)
        self.steps.append(Step(pose, error, self._estimate(image), None, None, np.nan))
        decision = self._decision()
        commanded = None if isinstance(decision, RunEnded) else decision
        seconds = time.perf_counter() - start
        self.steps[-1] = replace(self.steps[-1], commanded=commanded, seconds=seconds)
        if self.on_step is not None:
            self.on_step(self.steps[-1], image)
        if isinstance(decision, RunEnded):
            raise decision
        return decision

    def _check_image(self, image: Image, pose: Array) -> None:
        if reason := guard.exposure_fault(image, self.estimator.reference_image):
            raise RunEnded("camera_fault", reason)
        if self._last_change is not None and np.array_equal(image, self._last_change[0]):
            moved = inverse_transform(self._last_change[1]) @ pose
            if reason := guard.frozen_fault(moved, self.estimator.reach, self.estimator.pivot):
                raise RunEnded("camera_fault", reason)
        else:
            self._last_change = image, pose

    def _estimate(self, image: Image) -> Estimate:
        previous = self.steps[-1].estimate if self.steps else None
        try:
            return self.estimator.estimate(image, previous)
        except Exception as error:
            reason = f"The estimator failed: {type(error).__name__}: {one_line(error)}"
            raise RunEnded("abstained", reason) from error

    def _decision(self) -> Array | RunEnded:
        """The move that the last step asks for, or why none is to be made."""
        estimate, settings = self.steps[-1].estimate, self.settings
        if reason := guard.estimate_fault(estimate, settings.novelty_limit):
            return RunEnded("abstained", reason)
        errors = [step.image_error for step in self.steps]
        if guard.is_diverging(errors, settings.growth):
            return RunEnded("diverged", _divergence_message(errors))
        believed = [step.estimate.distance for step in self.steps]
        if not estimate.is_finest and guard.is_wandering(believed, int(settings.patience)):
            return RunEnded("diverged", _wandering_message(estimate, settings))
        if arrived := self._arrival(estimate):
            return arrived
        if self.robot.moves >= settings.max_moves:
            return RunEnded("max_moves", _max_moves_message(estimate, settings))
        return self._next_move(estimate)

    def _arrival(self, estimate: Estimate) -> RunEnded | None:
        moves = "1 move" if self.robot.moves == 1 else f"{self.robot.moves} moves"
        there = f"after {moves}, believed {as_text(estimate.displacement)} away."
        if is_within_tolerance(estimate.displacement, self.settings):
            return RunEnded("converged", f"Converged {there}")
        estimates = [step.estimate for step in self.steps]
        if is_noise_only(estimates, self.estimator.pivot, self.settings):
            return RunEnded("converged", f"As close as the noise allows {there}")
        return None

    def _next_move(self, estimate: Estimate) -> Array | RunEnded:
        reach, pivot = self.estimator.reach, self.estimator.pivot
        step = getattr(estimate, "step", None)
        wanted = inverse_transform(estimate.displacement if step is None else step)
        commanded = guard.limited(wanted, pivot, self.settings.step_limits(reach, pivot))
        box = self.settings.workspace(reach, pivot)
        T_start, T_next = self.steps[0].pose, self.steps[-1].pose @ commanded
        if reason := guard.workspace_fault(T_start, T_next, box):
            return RunEnded("out_of_workspace", reason)
        return commanded

    def _move(self, commanded: Array) -> Array:
        self.is_moving = True
        executed = self.robot.move(commanded)
        self.is_moving = False
        return executed

    def _return_to_best(self) -> None:
        """Go back the way it came to the least image error, if the last is worse.

        Where the finest stage answers it has to be clearly worse: the camera is near.
        """
        errors = [step.image_error for step in self.steps]
        best = int(np.argmin(errors))
        margin = self.settings.growth if self.steps[-1].estimate.is_finest else 0.0
        if errors[-1] <= errors[best] + margin:
            return
        for step in reversed(self.steps[best:-1]):
            self._move(inverse_transform(self.robot.pose) @ step.pose)
        self.returned_to = best

    def _belief(self) -> tuple[Array, Array]:
        """What is believed where the robot stands: remaining displacement and deviation, (6,)."""
        unknown = np.full(6, np.nan)
        if not self.steps or self.is_moving:
            return unknown, unknown
        step = self.steps[-1 if self.returned_to is None else self.returned_to]
        displacement = step.estimate.displacement
        if not guard.is_finite_rigid(displacement):
            return unknown, unknown
        if step.executed is not None and self.returned_to is None:
            displacement = displacement @ step.executed
        pivot = self.estimator.pivot
        delta_p = displacements_from_poses(np.eye(4), displacement[None], pivot)[0]
        return delta_p, np.array(step.estimate.std, dtype=float)


def _dry_run_message(commanded: Array) -> str:
    return f"Dry run: the robot would move {as_text(commanded)}; nothing was moved."


def _max_moves_message(estimate: Estimate, settings: LoopSettings) -> str:
    return (
        f"Still {as_text(estimate.displacement)} away, as believed, after {settings.max_moves} "
        "moves; allow more moves, or a tolerance that the noise and the robot can meet."
    )


def _divergence_message(errors: list[float]) -> str:
    return (
        f"The image error grew from {min(errors):.2f} to {errors[-1]:.2f} over two moves: the "
        "moves lead away; see that the robot moves in the frame of the training poses, and that "
        "the view is free."
    )


def _wandering_message(estimate: Estimate, settings: LoopSettings) -> str:
    return (
        f"Still {as_text(estimate.displacement)} away, as believed, and no nearer for "
        f"{settings.patience} moves; free the view, or begin nearer to the reference."
    )
