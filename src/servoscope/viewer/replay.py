"""A run that has been, gone through look by look."""

from __future__ import annotations

import threading
from collections.abc import Callable
from os import PathLike

from servoscope.errors import RunFolderError
from servoscope.positioning.interfaces import Estimator
from servoscope.positioning.run_log import read_end, read_reference, read_steps
from servoscope.viewer.history import History, Look, Setting

PACE = 0.7
"""Time between looks, [s]."""


def read_log(folder: str | PathLike[str], estimator: Estimator | None = None) -> History:
    """The history of a run that ``position --log`` wrote.

    Parameters
    ----------
    folder : path
    estimator : Estimator, optional
        That of the run: a keyframe model knows the camera and the relief, which a log does not.

    Raises
    ------
    RunFolderError
        If the log is missing, damaged, of another version, or holds no look.
    InvalidInputError
        If the estimator has another reference image.
    """
    reference, pivot = read_reference(folder)
    setting = Setting(reference, pivot).known_by(estimator)
    looks = [Look.of_step(step, image, setting) for step, image in read_steps(folder)]
    if not looks:
        raise RunFolderError(f"The log {folder} holds no look: the run ended before the first.")
    return History(setting, looks, read_end(folder) or "The log ends here: the run was cut short.")


class Replay:
    """Goes through a history that is finished: a look at a time, or at a pace.

    Parameters
    ----------
    history : History
    show : callable
        Called with the number of the look that is to be seen, from 0.
    """

    def __init__(self, history: History, show: Callable[[int], object]) -> None:
        self.history, self._show = history, show
        self.current = 0
        self._is_running = threading.Event()

    def step(self) -> None:
        """Show the next look, and stay there."""
        self._is_running.clear()
        self._advance()

    def run(self) -> None:
        """Show the looks one after the other; from the first, if the last is shown."""
        if self.current == len(self.history.looks) - 1:
            self.seek(0)
        self._is_running.set()

    def stop(self) -> None:
        """Stay at this look."""
        self._is_running.clear()

    def seek(self, k: int) -> None:
        """Show look `k`."""
        self.current = min(max(int(k), 0), len(self.history.looks) - 1)
        self._show(self.current)

    def until_closed(self) -> None:
        """Advance at the pace while it is to run; until Ctrl-C."""
        closed = threading.Event()
        while not closed.wait(PACE):
            self.tick()

    def tick(self) -> None:
        """What happens once in `PACE`."""
        if self._is_running.is_set():
            self._advance()

    def _advance(self) -> None:
        if self.current == len(self.history.looks) - 1:
            self._is_running.clear()
        else:
            self.seek(self.current + 1)
