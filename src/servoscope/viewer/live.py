"""A run of the loop that a person commands: the robot moves on step and run alone."""

from __future__ import annotations

from collections.abc import Callable

from servoscope.errors import RobotFaultError
from servoscope.positioning.interfaces import Array, Camera, Image, Robot
from servoscope.positioning.look_and_move import Positioner
from servoscope.positioning.result import PositioningResult, Step
from servoscope.positioning.run import OnStep
from servoscope.viewer.buttons import Buttons
from servoscope.viewer.history import History, Look


class LiveRun(Buttons):
    """One run of a positioner, which waits before each move until it may make it.

    Step lets it make one move, and ends running; run lets it make all that follow. Stop ends the
    run as Ctrl-C does, also within a move: the loop stops the robot. Moves that were not shown,
    those back to the best view after a run that diverged, are made while running only.

    Parameters
    ----------
    positioner : Positioner
    robot : Robot
    camera : Camera
    history : History
        Gains a look at each step.
    show : callable
        Called with the number of a look that is to be seen, from 0.
    say : callable
        Called with how it stands, in words.
    truth : callable, optional
        The displacement of the reported frame as it is, (4, 4), [m].
    on_step : callable, optional
        As of `Positioner.run`: called before a look is shown.
    """

    def __init__(
        self,
        positioner: Positioner,
        robot: Robot,
        camera: Camera,
        history: History,
        show: Callable[[int], object],
        say: Callable[[str], object],
        *,
        truth: Callable[[], Array] | None = None,
        on_step: OnStep | None = None,
    ) -> None:
        super().__init__(robot)
        self.history = history
        self._positioner, self._camera = positioner, camera
        self._show, self._say, self._truth, self._on_step = show, say, truth, on_step
        self._is_allowed = False

    def until_end(self) -> PositioningResult:
        """Run until the loop ends or is stopped; in the main thread, so that Stop ends moves."""
        self.begin()
        try:
            result = self._positioner.run(self.robot, self._camera, on_step=self._look)
        finally:
            self.end()
        self.history.end = f"{result.status}: {result.message}"
        self._say(self.history.end)
        return result

    def seek(self, k: int) -> None:
        """Show look `k`."""
        self._show(min(max(int(k), 0), len(self.history.looks) - 1))

    def _look(self, step: Step, image: Image) -> None:
        if self._on_step is not None:
            self._on_step(step, image)
        truth = None if self._truth is None else self._truth()
        look = Look.of_step(step, image, self.history.setting, truth)
        self.history.looks.append(look)
        self._show(len(self.history.looks) - 1)
        if step.commanded is None:
            self._say(look.words)
            return
        if self.is_held:
            self._say(f"{look.words} The robot waits: press Step or Run.")
        self.wait()
        self._is_allowed = True
        self._say(f"{look.words} The robot moves.")

    def check_move(self) -> None:
        """Raise if the robot may not move now; a move that was shown may be made once."""
        is_allowed, self._is_allowed = self._is_allowed, False
        if self.was_stopped or not (is_allowed or self.is_running):
            raise RobotFaultError(
                "the loop gave up and would drive back to the best view, which is done after "
                "Run alone"
            )
