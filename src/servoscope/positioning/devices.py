"""A camera and a robot under watch: whatever they do wrong ends the run with a reason."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any, TypeVar

from servoscope.poses import inverse_transform
from servoscope.positioning.guard import execution_fault, image_format_fault, is_finite_rigid
from servoscope.positioning.interfaces import Array, Camera, Image, Robot
from servoscope.positioning.settings import LoopSettings

T = TypeVar("T")

_LONGEST_WAIT = 0.1
"""Ctrl-C may not be heard while a thread is waited for, so that this is never done for long."""


class RunEnded(Exception):
    """The end of a run, with its status and the reason in one line."""

    def __init__(self, status: str, reason: str) -> None:
        super().__init__(reason)
        self.status = status


class WatchedCamera:
    """A camera whose failures are faults of the camera.

    Parameters
    ----------
    camera : Camera
    image_shape : tuple of 2 int
        Height and width that its images must have.
    settings : LoopSettings
    """

    def __init__(
        self, camera: Camera, image_shape: tuple[int, int], settings: LoopSettings
    ) -> None:
        self._camera = camera
        self._image_shape = image_shape
        self._timeout = settings.read_timeout_s

    def read(self) -> Image:
        """A new image of the right kind and size."""
        try:
            image = call_within(self._timeout, self._camera.read)
        except TimeoutError as error:
            reason = f"The camera gave no image ({one_line(error)}); see that it is connected."
            raise RunEnded("camera_fault", reason) from error
        except Exception as error:
            raise RunEnded("camera_fault", f"The camera failed: {one_line(error)}") from error
        if fault := image_format_fault(image, self._image_shape):
            raise RunEnded("camera_fault", fault)
        return image.copy()


class WatchedRobot:
    """A robot whose failures are faults of the robot, and which is stopped after one.

    Parameters
    ----------
    robot : Robot
        May offer ``stop()``.
    settings : LoopSettings

    Attributes
    ----------
    moves : int
        Moves that it completed.
    """

    def __init__(self, robot: Robot, settings: LoopSettings) -> None:
        self._robot = robot
        self._settings = settings
        self.moves = 0

    @property
    def pose(self) -> Array:
        """``T_world_cam`` as it believes it, (4, 4), [m]."""
        try:
            pose = call_within(self._settings.read_timeout_s, lambda: self._robot.pose)
        except Exception as error:
            raise self._fault(f"The robot does not tell its pose: {one_line(error)}") from error
        if not is_finite_rigid(pose):
            raise self._fault(
                f"The robot must tell its pose as a finite rigid (4, 4) array, but told "
                f"{one_line(pose)}; see that it is referenced."
            )
        return pose.copy()

    def move(self, displacement: Array) -> Array:
        """Move by a displacement, and see that this is what it did."""
        before = self.pose
        try:
            executed = call_within(
                self._settings.move_timeout_s, lambda: self._robot.move(displacement.copy())
            )
        except TimeoutError as error:
            reason = f"The robot did not finish the move ({one_line(error)})."
            raise self._fault(reason) from error
        except Exception as error:
            raise self._fault(f"The robot did not move: {one_line(error)}") from error
        if not is_finite_rigid(executed):
            raise self._fault(
                "The robot must tell the executed displacement as a finite rigid (4, 4) array, "
                f"but told {one_line(executed)}."
            )
        for motion in (executed, inverse_transform(before) @ self.pose):
            if fault := execution_fault(displacement, motion, self._settings):
                raise self._fault(fault)
        self.moves += 1
        return executed.copy()

    def stop(self) -> str:
        """Stop the robot, if it can be; what came of it in a few words, for a message."""
        stop = getattr(self._robot, "stop", None)
        if stop is None:
            return "It offers no stop(), and may still be moving."
        try:
            call_within(self._settings.read_timeout_s, stop)
        except Exception as error:
            return f"Its stop() failed: {one_line(error)}"
        return "It was stopped."

    def _fault(self, reason: str) -> RunEnded:
        return RunEnded("robot_fault", f"{reason} {self.stop()}")


def call_within(seconds: float | None, call: Callable[[], T]) -> T:
    """What a call returns or raises, or TimeoutError if it takes too long.

    The call has a thread of its own, which is left behind if it does not come back. Without a
    limit it runs in the thread of the caller.
    """
    if seconds is None:
        return call()
    outcome: dict[str, Any] = {}

    def run() -> None:
        try:
            outcome["value"] = call()
        except BaseException as error:
            outcome["error"] = error

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    end = time.monotonic() + seconds
    while thread.is_alive() and (left := end - time.monotonic()) > 0:
        thread.join(min(left, _LONGEST_WAIT))
    if thread.is_alive():
        raise TimeoutError(f"time-out after {seconds:g} s")
    if "error" in outcome:
        raise outcome["error"]
    return outcome["value"]


def one_line(value: object, longest: int = 200) -> str:
    """A value, or the message of an exception, in one line; its kind if it says nothing."""
    text = " ".join(str(value).split()) or type(value).__name__
    return text if len(text) <= longest else text[: longest - 3] + "..."
