"""What a person allows a robot: one step, everything, or nothing more."""

from __future__ import annotations

import _thread
import signal
import threading
from collections.abc import Callable
from typing import Any

from servoscope.errors import RobotFaultError
from servoscope.positioning.interfaces import Array, Robot

HELD, ONE_STEP, RUNNING, STOPPED, OVER = "held", "one step", "running", "stopped", "over"

_LONGEST_WAIT = 0.1
"""Ctrl-C may not be heard while something is waited for, so that this is never done for long."""

_PATIENCE = 0.3
"""So long after Stop the work may take to stop the robot, [s]."""


class Buttons:
    """Step, Run and Stop of work that moves a robot.

    At first nothing is allowed. Stop ends the work as Ctrl-C does, also within a move, so that it
    is the work that stops the robot; if it does not at once, as on its way back after a fault, or
    after the end, the robot itself is stopped. After Stop no further move begins.

    Parameters
    ----------
    robot : Robot

    Attributes
    ----------
    robot : Robot
        What the work is to move.
    was_stopped : bool
        Whether Stop was pressed before the end; another interruption is by a signal.
    """

    def __init__(self, robot: Robot) -> None:
        self._device = robot
        self._is_standing = threading.Event()
        self.robot: Any = _Guarded(robot, self.check_move, self._is_standing.set)
        self._changed = threading.Condition()
        self._state = HELD
        self._thread: threading.Thread | None = None
        self.was_stopped = False

    def begin(self) -> None:
        """The work is done in this thread; in the main one Stop ends moves as well."""
        self._thread = threading.current_thread()

    def step(self) -> None:
        """Allow one step; while running, none after the one that is being made."""
        self._allow(HELD if self._state == RUNNING else ONE_STEP)

    def run(self) -> None:
        """Allow all that follows."""
        self._allow(RUNNING)

    def stop(self) -> None:
        """End the work and stop the robot; if it has ended, or was stopped, stop the robot."""
        with self._changed:
            is_first = self._state not in (STOPPED, OVER)
            if is_first:
                self._state, self.was_stopped = STOPPED, True
            self._changed.notify_all()
        if is_first and self._is_interrupted_by_a_signal():
            _thread.interrupt_main()
            if self._is_standing.wait(_PATIENCE):
                return
        getattr(self._device, "stop", lambda: None)()

    def check_move(self) -> None:
        """Called before every move.

        Raises
        ------
        RobotFaultError
            If it may not be made.
        """
        if self.was_stopped:
            raise RobotFaultError("Stop was pressed")

    @property
    def is_held(self) -> bool:
        """Whether the next step would have to wait."""
        return self._state == HELD

    @property
    def is_running(self) -> bool:
        """Whether all that follows is allowed."""
        return self._state == RUNNING

    def wait(self) -> None:
        """Wait until the next step is allowed, which it is once if it was Step.

        Raises
        ------
        KeyboardInterrupt
            If Stop was pressed.
        """
        with self._changed:
            while self._state == HELD:
                self._changed.wait(_LONGEST_WAIT)
            if self._state == STOPPED:
                raise KeyboardInterrupt("Stop")
            if self._state == ONE_STEP:
                self._state = HELD

    def end(self) -> None:
        """Nothing is moved any more."""
        with self._changed:
            self._state = OVER

    def _allow(self, state: str) -> None:
        with self._changed:
            if self._state not in (STOPPED, OVER):
                self._state = state
                self._changed.notify_all()

    def _is_interrupted_by_a_signal(self) -> bool:
        is_heard = signal.getsignal(signal.SIGINT) not in (signal.SIG_IGN, None)
        return is_heard and self._thread is threading.main_thread()


class _Guarded:
    """A robot that is asked whether it may move before every move, and whose stop is noticed."""

    def __init__(
        self, robot: Robot, check: Callable[[], None], on_stop: Callable[[], None]
    ) -> None:
        self._robot, self._check, self._on_stop = robot, check, on_stop

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._robot, name)
        if name == "stop":
            return self._stopping(value)
        return self._checked(value) if name in ("move", "move_to") else value

    def _checked(self, move: Callable[[Array], Any]) -> Callable[[Array], Any]:
        def checked(pose: Array) -> Any:
            self._check()
            return move(pose)

        return checked

    def _stopping(self, stop: Callable[[], Any]) -> Callable[[], Any]:
        def stopping() -> Any:
            self._on_stop()
            return stop()

        return stopping
