"""A camera and a robot under watch: whatever they do wrong ends the run with a reason."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable
from types import FrameType, TracebackType
from typing import Any, TypeVar

from servoscope.poses import inverse_transform, nearest_rigid
from servoscope.positioning.guard import (
    execution_fault,
    image_format_fault,
    is_finite_rigid,
    standing_fault,
)
from servoscope.positioning.interfaces import Array, Camera, Image, Robot
from servoscope.positioning.settings import LoopSettings
from servoscope.wording import one_line

T = TypeVar("T")

_LONGEST_WAIT = 0.1
"""Ctrl-C may not be heard while a thread is waited for, so that this is never done for long."""

_LONGEST_STOP = 10.0
"""A stop() that takes longer than this is given up, [s]."""


class RunEnded(Exception):
    """The end of a run, with its status and the reason in one line."""

    def __init__(self, status: str, reason: str) -> None:
        super().__init__(reason)
        self.status = status


class Interruption:
    """Signals to end, heard once: the first raises KeyboardInterrupt, later ones change nothing.

    So a second Ctrl-C cannot cut short what the first one began. Should a driver or a callback
    catch the first, `check` raises it again. A handler of the caller's own is called at the end.
    In threads other than the main one nothing is changed.

    Examples
    --------
    >>> with Interruption() as interruption:
    ...     interruption.hold()
    ...     signal.raise_signal(signal.SIGINT)  # changes nothing any more
    """

    def __init__(self) -> None:
        self._heard: signal.Signals | None = None
        self._is_held = False
        self._before: dict[int, Any] = {}

    @property
    def heard(self) -> str | None:
        """The name of the signal that was heard."""
        return None if self._heard is None else self._heard.name

    def hold(self) -> None:
        """From now on no signal is heard."""
        self._is_held = True

    def check(self) -> None:
        """Raise KeyboardInterrupt if a signal was heard, and caught by somebody else."""
        if self._heard is not None and not self._is_held:
            raise KeyboardInterrupt(self._heard.name)

    def __enter__(self) -> Interruption:
        if threading.current_thread() is threading.main_thread():
            for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK"):
                number = getattr(signal, name, None)
                if number is not None and signal.getsignal(number) not in (signal.SIG_IGN, None):
                    self._before[number] = signal.signal(number, self._hear)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
        own = self._before.get(self._heard) if self._heard is not None else None
        if callable(own) and own is not signal.default_int_handler:
            own(self._heard, None)

    def _hear(self, number: int, frame: FrameType | None) -> None:
        if self._heard is None and not self._is_held:
            self._heard = signal.Signals(number)
            raise KeyboardInterrupt(self._heard.name)


class WatchedCamera:
    """A camera whose failures are faults of the camera.

    Parameters
    ----------
    camera : Camera
    image_shape : tuple of 2 int
        Height and width that its images must have.
    settings : LoopSettings

    Attributes
    ----------
    seconds : float
        How long it was waited for so far.
    """

    def __init__(
        self, camera: Camera, image_shape: tuple[int, int], settings: LoopSettings
    ) -> None:
        self._camera = camera
        self._image_shape = image_shape
        waits = settings.read_timeout_s is not None
        self._timeout = settings.first_read_timeout_s if waits else None
        self._later_timeout = settings.read_timeout_s
        self.seconds = 0.0

    def read(self) -> Image:
        """A new image of the right kind and size."""
        start = time.perf_counter()
        try:
            image = call_within(self._timeout, self._camera.read)
        except KeyboardInterrupt:
            raise
        except TimeoutError as error:
            reason = (
                f"The camera gave no image ({one_line(error)}); see that it is connected, or allow "
                "it more time."
            )
            raise RunEnded("camera_fault", reason) from error
        except BaseException as error:
            raise RunEnded("camera_fault", f"The camera failed: {one_line(error)}") from error
        self.seconds += time.perf_counter() - start
        self._timeout = self._later_timeout
        if fault := image_format_fault(image, self._image_shape):
            raise RunEnded("camera_fault", fault)
        return image.copy()


class WatchedRobot:
    """A robot whose failures are faults of the robot.

    Parameters
    ----------
    robot : Robot
    settings : LoopSettings

    Attributes
    ----------
    moves : int
        Moves that it completed.
    is_lost : bool
        Whether it may stand elsewhere than where it was last seen from: a move was commanded that
        it has not completed, or it moved without a command.
    """

    def __init__(self, robot: Robot, settings: LoopSettings) -> None:
        self._robot = robot
        self._settings = settings
        self.moves = 0
        self.is_lost = False

    @property
    def pose(self) -> Array:
        """``T_world_cam`` as it reports it, (4, 4), [m]."""
        try:
            pose = call_within(self._settings.read_timeout_s, lambda: self._robot.pose)
        except KeyboardInterrupt:
            raise
        except BaseException as error:
            raise _fault(f"The robot does not report its pose: {one_line(error)}") from error
        if not is_finite_rigid(pose):
            raise _fault(
                f"The robot must report its pose as a finite rigid (4, 4) array, but reported "
                f"{one_line(pose)}; see that it is referenced."
            )
        return nearest_rigid(pose)

    def check_standing(self, T_world_cam: Array) -> None:
        """End the run if it is no longer where it was when the image was taken."""
        if fault := standing_fault(T_world_cam, self.pose, self._settings):
            self.is_lost = True
            raise _fault(fault)

    def move(self, displacement: Array, T_world_cam: Array) -> Array:
        """Move by a displacement from a pose, if it is there, and see that this is what it did."""
        self.check_standing(T_world_cam)
        self.is_lost = True
        displacement = nearest_rigid(displacement)
        try:
            executed = call_within(
                self._settings.move_timeout_s, lambda: self._command(displacement, T_world_cam)
            )
        except KeyboardInterrupt:
            raise
        except TimeoutError as error:
            raise _fault(f"The robot did not finish the move ({one_line(error)}).") from error
        except BaseException as error:
            raise _fault(f"The robot did not move: {one_line(error)}") from error
        if not is_finite_rigid(executed):
            raise _fault(
                "The robot must report the executed displacement as a finite rigid (4, 4) array, "
                f"but reported {one_line(executed)}."
            )
        for motion in (executed, inverse_transform(T_world_cam) @ self.pose):
            if fault := execution_fault(displacement, motion, self._settings):
                raise _fault(fault)
        self.is_lost = False
        self.moves += 1
        return nearest_rigid(executed)

    def _command(self, displacement: Array, T_world_cam: Array) -> Any:
        """Make a move; the displacement that the robot reports."""
        if hasattr(self._robot, "move"):
            return self._robot.move(displacement.copy())
        self._robot.move_to(nearest_rigid(T_world_cam @ displacement))
        return inverse_transform(T_world_cam) @ self.pose

    def stop(self) -> str:
        """Stop the robot, if it can be; what came of it in a few words, for a message."""
        try:
            stop = getattr(self._robot, "stop", None)
            if stop is None:
                return "It offers no stop(), and may still be moving."
            timeout = self._settings.move_timeout_s
            call_within(None if timeout is None else _LONGEST_STOP, stop)
        except BaseException as error:
            return f"Its stop() failed: {one_line(error)}"
        return "It was stopped."


def _fault(reason: str) -> RunEnded:
    return RunEnded("robot_fault", reason)


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
