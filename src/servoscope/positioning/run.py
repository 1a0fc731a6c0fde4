"""One run of the loop, until there is a reason to end it."""

from __future__ import annotations

import time
from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from typing import NoReturn

import numpy as np

from servoscope.dofs import mask_of
from servoscope.poses import DOFS, displacements_from_poses, inverse_transform
from servoscope.positioning import arrival, guard
from servoscope.positioning.consistency import CAUSES, LATE, Innovation, innovation
from servoscope.positioning.devices import Interruption, RunEnded, WatchedCamera, WatchedRobot
from servoscope.positioning.guard import as_text
from servoscope.positioning.interfaces import (
    Array,
    Camera,
    Estimate,
    Estimator,
    Image,
    Robot,
    dofs_of,
)
from servoscope.positioning.reference_view import Comparison, ReferenceView
from servoscope.positioning.result import PositioningResult, Step
from servoscope.positioning.settings import ORDINARY_MISS, LoopSettings
from servoscope.wording import one_line

OnStep = Callable[[Step, Image], object]

_RETURNING = ("diverged", "max_moves")
_MOST_UNCONFIRMED = 2
_MOST_CORRECTIONS = 2
_MOST_LOOKS = 10
_FAR = 0.1
_LEAST_SEEN = 0.05
_SAME_CELLS = 0.9
_REMEMBERED = 4
_ARRIVED = ("converged", "limited")
_STOP_IS_REPORTED = ("robot_fault", "interrupted")


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
        self.dofs = dofs_of(estimator)
        self.settings = settings
        self.robot = WatchedRobot(robot, settings)
        self.camera = WatchedCamera(camera, estimator.image_shape, settings)
        self.on_step = on_step
        self.reference = ReferenceView(estimator.reference_image)
        self.steps: list[Step] = []
        self.returned_to: int | None = None
        self._moved_after: list[tuple[Step, Image]] = []
        self._contradicted_by: str | None = None
        self._is_late = False
        self._n_doubts, self._n_unsteady, self._n_corrections = 0, 0, 0
        self._last_change: tuple[Image, Array] | None = None
        self._last_image: Image = estimator.reference_image

    def until_end(self, dry_run: bool) -> PositioningResult:
        """Look and move until there is a reason not to, stop the robot, and say how it ended."""
        with Interruption() as interruption:
            try:
                status, message = self._ended(interruption, dry_run)
            except KeyboardInterrupt as end:
                interruption.hold()
                status, message = "interrupted", f"Interrupted{_by_whom(end)}."
            except BaseException:
                interruption.hold()
                self.robot.stop()
                raise
            if not dry_run or status in _STOP_IS_REPORTED:
                stopped = self.robot.stop()
                if status in _STOP_IS_REPORTED or "failed" in stopped:
                    message = f"{message} {stopped}"
        return self._result(status, message)

    def _ended(self, interruption: Interruption, dry_run: bool) -> tuple[str, str]:
        """Status and message of the end, after which no signal is heard any more."""
        try:
            self._approach(interruption, dry_run)
        except RunEnded as end:
            interruption.hold()
            if interruption.heard is not None:  # a driver, or a lock, made another error of it
                return "interrupted", f"Interrupted{_by_whom(interruption.heard)}. {end}"
            return end.status, str(end)
        except (SystemExit, GeneratorExit) as end:
            interruption.hold()
            return "interrupted", f"Interrupted{_by_whom(end)}."

    def _approach(self, interruption: Interruption, dry_run: bool) -> NoReturn:
        try:
            n_looks = 0
            while True:
                interruption.check()
                commanded, n_looks = self._look(), n_looks + 1
                if commanded is None and n_looks < _MOST_LOOKS:
                    continue
                if commanded is None:
                    raise RunEnded("abstained", _UNDECIDED)
                n_looks = 0
                if dry_run:
                    raise RunEnded("dry_run", _dry_run_message(commanded))
                self._moved_after.append((self.steps[-1], self._last_image))
                self._contradicted_by, self._n_unsteady = None, 0
                interruption.check()
                executed = self.robot.move(commanded, self.steps[-1].pose)
                self.steps[-1] = replace(self.steps[-1], executed=executed)
        except RunEnded as end:
            is_coarse = self.settings.is_coarse and end.status == "limited"
            is_asked_to_end = interruption.heard is not None
            if (end.status in _RETURNING or is_coarse) and not dry_run and not is_asked_to_end:
                self._return_to_best()
            raise

    def _result(self, status: str, message: str) -> PositioningResult:
        if self._is_late:
            message += (
                " The camera gave images late, or unsteady ones, so that two were taken for each."
            )
        if self.returned_to is not None:
            message += f" The robot went back to the best pose seen, look {self.returned_to + 1}."
        remaining, std = self._belief()
        return PositioningResult(
            status, message, self.robot.moves, remaining, std, tuple(self.steps), self.returned_to,
            self.dofs,
        )  # fmt: skip

    def _look(self) -> Array | None:
        """Take an image and decide: the move to make, or None to look again from here."""
        pose = self.robot.pose
        if self._is_late:
            self.camera.read()
        image = self.camera.read()
        start = time.perf_counter() - self.camera.seconds
        self._check_image(image, pose)
        self._last_image = image
        comparison, error = self.reference.compare(image), self.reference.error(image)
        estimate = self._estimate(image)
        self.steps.append(Step(pose, error, estimate, None, None, np.nan, comparison))
        decision = self._decision()
        has_arrived = isinstance(decision, RunEnded) and decision.status in _ARRIVED
        if has_arrived or (self._n_corrections and isinstance(decision, np.ndarray)):
            decision = self._confirmed(decision, image)
        commanded = None if isinstance(decision, RunEnded) else decision
        seconds = time.perf_counter() - self.camera.seconds - start
        self.steps[-1] = replace(self.steps[-1], commanded=commanded, seconds=seconds)
        self._report(image)
        self.robot.check_standing(pose)
        if isinstance(decision, RunEnded):
            raise decision
        return decision

    def _confirmed(
        self, decision: Array | RunEnded | None, image: Image
    ) -> Array | RunEnded | None:
        """The decision that more images from the same pose lead to.

        A late camera first shows where the robot was before. Where the images differ two are
        taken from then on. Their mean is less noisy than the first.
        """
        first, images = ReferenceView(image), [image]
        is_averaged = arrival.is_averaged(
            self.steps[-1].estimate, self.estimator.pivot, self.settings
        )
        for _ in range(1, max(2, self.settings.final_images if is_averaged else 2)):
            image = self.camera.read()
            if reason := guard.exposure_fault(image, self.estimator.reference_image):
                return RunEnded("camera_fault", reason)
            if first.shift(image) > arrival.STEADY_SHIFT:
                compared = first.compare(image)
                if arrival.is_displaced(compared):
                    return self._unsteady(compared)
            images.append(image)
        return self._averaged(images) if is_averaged else decision

    def _unsteady(self, compared: Comparison) -> RunEnded | None:
        """The end of a run whose view moves while the robot stands, once that is certain."""
        self._is_late = True
        self._n_unsteady += 1
        if self._n_unsteady < _MOST_UNCONFIRMED:
            return None
        difference = (
            f"are displaced by {compared.shift:.2%} of their width"
            if np.isfinite(compared.shift)
            else "show different views"
        )
        reason = (
            f"Two images from the same pose {difference}; see that nothing moves in the view, and "
            "that the camera gives new images."
        )
        return RunEnded("abstained", reason)

    def _averaged(self, images: list[Image]) -> Array | RunEnded | None:
        """The end of a run by the mean of several images, or the move that it asks for."""
        settings, pivot = self.settings, self.estimator.pivot
        mean = np.rint(np.mean(images, axis=0, dtype=np.float32)).astype(np.uint8)
        estimate = self._estimate(mean)
        if reason := guard.novelty_fault(estimate, settings):
            return RunEnded("abstained", reason)
        first = self.steps[-1].estimate
        self.steps[-1] = replace(
            self.steps[-1], estimate=estimate, first_displacement=first.displacement
        )
        may_move = self._n_corrections < _MOST_CORRECTIONS
        scatter = arrival.scatter(self.steps, settings, pivot)
        is_off = arrival.asks_for_a_move(first, estimate, len(images), pivot, settings, scatter)
        if may_move and self.robot.moves < settings.max_moves and is_off:
            self._n_corrections += 1
            return self._next_move(estimate)
        return self._arrival(is_settled=True) or self._next()

    def _report(self, image: Image) -> None:
        if self.on_step is None:
            return
        try:
            self.on_step(deepcopy(self.steps[-1]), image.copy())
        except KeyboardInterrupt:
            raise
        except BaseException as error:
            reason = f"on_step failed: {type(error).__name__}: {one_line(error)}"
            raise RunEnded("callback_fault", reason) from error

    def _check_image(self, image: Image, pose: Array) -> None:
        if reason := guard.exposure_fault(image, self.estimator.reference_image):
            raise RunEnded("camera_fault", reason)
        if reason := guard.clipping_fault(self.reference.usable(image), self.settings):
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
            estimate = self.estimator.estimate(image, previous)
        except KeyboardInterrupt:
            raise
        except BaseException as error:
            reason = f"The estimator failed: {type(error).__name__}: {one_line(error)}"
            raise RunEnded("abstained", reason) from error
        if fault := guard.estimate_fault(estimate):
            raise RunEnded("abstained", fault)
        return estimate

    def _decision(self) -> Array | RunEnded | None:
        """The move that the last step asks for, why none is to be made, or None to look again."""
        step, settings = self.steps[-1], self.settings
        novelty = guard.novelty_fault(step.estimate, settings)
        if found := self._contradiction(is_novel=novelty is not None):
            if self._contradicted_by is not None:
                return RunEnded("inconsistent", _contradiction_message(found, step.estimate))
            self._contradicted_by = found.cause
            return None
        self._is_late = self._is_late or self._contradicted_by == LATE
        decision = RunEnded("abstained", novelty) if novelty else self._next()
        ending = decision.status if isinstance(decision, RunEnded) else None
        is_doubtful = ending not in (None, *_ARRIVED) or (ending is None and self._is_far())
        if is_doubtful and self._equals_reference():
            return RunEnded("converged", f"Converged {self._there()} {_EQUAL}")
        return decision

    def _next(self) -> Array | RunEnded | None:
        """The move from a view that is recognised, or why none is to be made."""
        if arrived := self._arrival():
            return arrived
        if diverged := self._divergence():
            return RunEnded("diverged", diverged)
        if self.robot.moves >= self.settings.max_moves:
            reason = _max_moves_message(self.steps, self.settings) + self._hindrances()
            return RunEnded("max_moves", reason)
        return self._next_move(self.steps[-1].estimate)

    def _contradiction(self, is_novel: bool) -> Innovation | None:
        """How the view did not follow the last moves; None if it did, or that cannot be judged.

        Several moves that are each too small to judge may together be large enough to see that the
        view stands still. A view that is not recognised has not followed them only if a fault
        explains what is seen. Images that are equal bit for bit are left to the check for frozen
        ones.
        """
        for n, (before, image) in enumerate(reversed(self._moved_after[-_REMEMBERED:])):
            found = self._contradiction_since(before, image, is_novel)
            if found is not None and (n == 0 or found.cause == LATE):
                return found
        return None

    def _contradiction_since(self, before: Step, image: Image, is_novel: bool) -> Innovation | None:
        largest, pivot = self.settings.largest_innovation, self.estimator.pivot
        if largest is None or np.array_equal(image, self._last_image):
            return None
        after = self.steps[-1]
        robot_std = self.settings.allowed_miss(pivot) / 2
        found = innovation(
            before.estimate,
            inverse_transform(before.pose) @ after.pose,
            after.estimate,
            pivot=pivot,
            reach=self.estimator.reach,
            robot_std=np.hypot(robot_std, 1.5 * self.settings.repeatability(pivot)),
        )
        if found.contradicts(largest) and (found.fits or not is_novel):
            return found
        if found.share <= largest or found.size <= _LEAST_SEEN:
            return None
        compared = ReferenceView(image).compare(self._last_image)
        is_same = compared.matched > _SAME_CELLS and not arrival.is_displaced(compared)
        return found._replace(cause=LATE, fits=True) if is_same else None

    def _equals_reference(self) -> bool:
        comparison = self.steps[-1].comparison
        return comparison is not None and arrival.is_equal(comparison)

    def _is_far(self) -> bool:
        """Whether a stage that is not the finest believes the camera far from the reference."""
        estimate, reach = self.steps[-1].estimate, self.estimator.reach
        pivot = self.estimator.pivot
        delta_p = displacements_from_poses(np.eye(4), estimate.displacement[None], pivot)[0]
        return not estimate.is_finest and bool((np.abs(delta_p) > _FAR * reach).any())

    def _arrival(self, *, is_settled: bool = False) -> RunEnded | None:
        """The end of a run that has arrived, or can come no nearer, which may be known before."""
        settings, pivot = self.settings, self.estimator.pivot
        estimate, estimates = self.steps[-1].estimate, [step.estimate for step in self.steps]
        excess = arrival.supports(estimate, settings, pivot)
        is_within = arrival.is_within_tolerance(estimate.displacement, settings, pivot)
        is_there = is_within and excess is None
        if not is_there and settings.is_coarse and arrival.is_back(self.steps):
            return self._as_near_as_the_robot_allows("It is back at a pose where it was.")
        allowed_by, note = "the noise", ""
        if not (is_there or arrival.is_noise_only(estimates, pivot, settings)):
            scatter = arrival.scatter(self.steps, settings, pivot)
            if scatter is None and not is_settled:
                self._n_doubts = 0
                return None
            if scatter is not None and scatter.any():
                rest = arrival.Reached.of_deviation(scatter, pivot)
                allowed_by = "the robot"
                note = (
                    f" It comes to rest {rest.mm:.2f} mm and {rest.deg:.3f} deg from where it is "
                    "sent."
                )
                if rest.mm > ORDINARY_MISS["mm"] or rest.deg > ORDINARY_MISS["deg"]:
                    return self._as_near_as_the_robot_allows(note)
        if found := arrival.doubts(self.steps[-1], settings):
            return self._unconfirmed(found) if is_within else None
        caution = arrival.caution(self.steps[-1])
        if arrival.is_otherwise(self.steps[-1]):
            return RunEnded("limited", f"As near as the view allows {self._there()}{caution}")
        if unread := arrival.unread(estimate, self.estimator.reach):
            lacking = f" The view does not inform {', '.join(unread)}."
            return RunEnded(
                "limited", f"As near as the view allows {self._there()}{lacking}{caution}"
            )
        if self.dofs != DOFS and arrival.is_displaced(self.steps[-1].comparison):
            left = (
                " The view is still displaced: the part lies otherwise in degrees of freedom that "
                f"are not commanded; of {', '.join(self.dofs)} the believed deviation does not "
                "include what that does."
            )
            return RunEnded("limited", f"As near as the robot can follow {self._there()}{left}")
        if is_there:
            return RunEnded("converged", f"Converged {self._there()}{caution}")
        reached = arrival.Reached.of_displacement(estimate.displacement, pivot)
        near = f"As near as {allowed_by} allows {self._there()}{note}"
        if above := reached.excess(settings) or excess:
            return RunEnded("limited", f"{near} The tolerance is not met: {above}.{caution}")
        return RunEnded("converged", near + caution)

    def _as_near_as_the_robot_allows(self, note: str) -> RunEnded:
        reason = f"As near as the robot allows {self._there()} {note.strip()}{self._hindrances()}"
        return RunEnded("limited", reason)

    def _unconfirmed(self, found: list[str]) -> RunEnded | None:
        """The end of a run that seemed twice to have arrived, with something against it."""
        self._n_doubts += 1
        if self._n_doubts < _MOST_UNCONFIRMED:
            return None
        there = as_text(self.steps[-1].estimate.displacement)
        return RunEnded("abstained", f"Believed {there} away, but unconfirmed: {'; '.join(found)}.")

    def _divergence(self) -> str | None:
        errors = [step.image_error for step in self.steps]
        if guard.is_diverging(errors, self.settings.growth):
            return _divergence_message(errors)
        estimate, patience = self.steps[-1].estimate, int(self.settings.patience)
        believed = [step.estimate.distance for step in self.steps]
        if not estimate.is_finest and guard.is_wandering(believed, patience):
            return _wandering_message(estimate, self.settings) + self._hindrances()
        return None

    def _hindrances(self) -> str:
        """What of the last image keeps the camera from arriving, as an end of a message."""
        found = arrival.doubts(self.steps[-1], self.settings)
        return f" At the last image {'; '.join(found)}." if found else ""

    def _there(self) -> str:
        moves = "1 move" if self.robot.moves == 1 else f"{self.robot.moves} moves"
        believed = as_text(self.steps[-1].estimate.displacement)
        untested = " Nothing was moved, so that neither camera nor robot was tested."
        return f"after {moves}, believed {believed} away." + untested * (self.robot.moves == 0)

    def _next_move(self, estimate: Estimate) -> Array | RunEnded:
        reach, pivot = self.estimator.reach, self.estimator.pivot
        step = getattr(estimate, "step", None)
        wanted = inverse_transform(estimate.displacement if step is None else step)
        commanded = guard.limited(wanted, pivot, self.settings.step_limits(reach, pivot))
        box = self.settings.workspace(reach, pivot)
        T_start, T_next = self.steps[0].pose, self.steps[-1].pose @ commanded
        if reason := guard.workspace_fault(T_start, T_next, box):
            return RunEnded("out_of_workspace", reason)
        workspace = self.settings.robot_box(self.estimator)
        for what, T in (("stands", self.steps[-1].pose), ("would be sent", T_next)):
            if not workspace.holds(T):
                reason = (
                    f"The robot {what} outside its workspace ({workspace}); move it inside, or "
                    "widen the workspace."
                )
                return RunEnded("out_of_workspace", reason)
        return commanded

    def _return_to_best(self) -> None:
        """Go back the way it came to the least image error, if the last is worse.

        Where the finest stage answers it has to be clearly worse: the camera is near.
        """
        errors = [step.image_error for step in self.steps]
        best = int(np.argmin(errors))
        margin = self.settings.growth if self.steps[-1].estimate.is_finest else 0.0
        if errors[-1] <= errors[best] + margin:
            return
        moved_from = [step for step in self.steps[best:-1] if step.executed is not None]
        for step in reversed(moved_from):
            here = self.robot.pose
            self.robot.move(inverse_transform(here) @ step.pose, here)
        self.returned_to = best

    def _belief(self) -> tuple[Array, Array]:
        """What is believed where the robot stands: remaining displacement and deviation, (6,)."""
        unknown = np.full(6, np.nan)
        if not self.steps or self.robot.is_lost:
            return unknown, unknown
        step = self.steps[-1 if self.returned_to is None else self.returned_to]
        displacement = step.estimate.displacement
        if not guard.is_finite_rigid(displacement):
            return unknown, unknown
        if step.executed is not None and self.returned_to is None:
            displacement = displacement @ step.executed
        pivot = self.estimator.pivot
        delta_p = displacements_from_poses(np.eye(4), displacement[None], pivot)[0]
        is_commanded = mask_of(self.dofs)
        std = np.array(step.estimate.std, dtype=float)
        return np.where(is_commanded, delta_p, np.nan), np.where(is_commanded, std, np.nan)


_UNDECIDED = (
    f"{_MOST_LOOKS} looks from one pose led to no decision; see that the view is free and stands "
    "still."
)
_EQUAL = "The image equals the reference to within its noise."


def _by_whom(end: object) -> str:
    name = one_line(end)
    return f" by {name}" if name in ("SIGTERM", "SIGHUP", "SIGBREAK") else " by the user"


def _dry_run_message(commanded: Array) -> str:
    return f"Dry run: the robot would move {as_text(commanded)}; nothing was moved."


def _contradiction_message(found: Innovation, seen: Estimate) -> str:
    return (
        f"The view did not follow the move: {as_text(found.expected)} from the reference was "
        f"expected, {as_text(seen.displacement)} is seen. It seems that {CAUSES[found.cause]}. If "
        "the robot scatters as much as that, give its repeatability."
    )


def _max_moves_message(steps: list[Step], settings: LoopSettings) -> str:
    *before, last = [step.estimate.distance for step in steps]
    is_nearing = not before or last < min(before)
    advice = (
        "allow more moves" if is_nearing else "the last moves brought it no nearer; free the view"
    )
    still = f"Still {as_text(steps[-1].estimate.displacement)} away, as believed,"
    return f"{still} after {settings.max_moves} moves; {advice}, or begin nearer to the reference."


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
