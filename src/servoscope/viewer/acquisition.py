"""An acquisition that a person commands: its plan, and each image as it is taken."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from servoscope.acquisition.plan import Plan
from servoscope.acquisition.recording import Shot
from servoscope.positioning.guard import as_text
from servoscope.positioning.interfaces import Image
from servoscope.viewer.browser import Browser
from servoscope.viewer.buttons import Buttons
from servoscope.viewer.history import History, Look, Setting
from servoscope.viewer.way import Way

N_MESSAGES = 4
"""So many of the latest messages stand beside the buttons."""

_UNSEEN = np.full((120, 160), 235, np.uint8)


def planned(plan: Plan, reference_image: Image = _UNSEEN) -> History:
    """The history of an acquisition before its first image."""
    return History(Setting(reference_image, plan.pivot), way=Way(plan))


class LiveAcquisition(Buttons):
    """What `acquire_from` is to call and to move, for a page whose buttons command it.

    Nothing is moved before Step or Run. Step lets the robot go to one image, and ends running; Run
    lets it take all. Stop ends the acquisition as Ctrl-C does, also within a move.

    Parameters
    ----------
    robot : Robot
    open_browser : callable
        Makes the page of a history; called once there is a plan.
    is_agreed : bool
        Whether it begins without a button.
    """

    def __init__(
        self, robot: Any, open_browser: Callable[[History], Browser], *, is_agreed: bool = False
    ) -> None:
        super().__init__(robot)
        self._open = open_browser
        self._page: _Page | None = None
        self._first: Shot | None = None
        self._messages: list[str] = []
        self._seconds = self._since = 0.0
        if is_agreed:
            self.run()

    @property
    def is_shown(self) -> bool:
        """Whether there was a plan, and so there is a page."""
        return self._page is not None

    def confirm(self, plan: Plan) -> bool:
        """Show the plan, and wait until a button agrees with it."""
        self.begin()
        history = planned(plan) if self._first is None else planned(plan, self._first.image)
        n_before = 0 if self._first is None else len(self._first.taken)
        self._page = page = _Page(self._open(history), history, Way(plan), n_before)
        page.browser.command(self)
        if self._first is not None:
            page.show(self._first)
        self._go_on(page, str(plan))
        return True

    def on_shot(self, shot: Shot) -> None:
        """Show an image, and wait until the robot may go on."""
        if self._page is None:
            self._first = shot
            return
        self._seconds += time.monotonic() - self._since
        self._page.show(shot)
        words = f"{shot}\n{self._page.progress(shot, self._seconds)}"
        if self._page.n_left(shot) or shot.number is not None:
            self._go_on(self._page, words)
        else:
            self._say(self._page, words)

    def on_message(self, message: str) -> None:
        """Show what a person should know, from now on."""
        self._messages.append(message)

    def finish(self, words: str) -> None:
        """Show how it ended; from now on Stop stops the robot itself."""
        self.end()
        if self._page is not None:
            self._page.browser.allow(step=False, run=False)
            self._say(self._page, words)

    def close(self) -> None:
        """Serve the page no longer."""
        if self._page is not None:
            self._page.browser.close()

    def seek(self, k: int) -> None:
        """Show image `k` of those that were taken, from 0, the reference among them."""
        if self._page is not None:
            self._page.browser.show(min(max(int(k), 0), len(self._page.history.looks) - 1))

    def _go_on(self, page: _Page, words: str) -> None:
        """Say how it stands, and wait until it may go on."""
        if self.is_held:
            self._say(page, f"{words}\nThe robot waits: press Step or Run.")
        self.wait()
        self._say(page, f"{words}\nThe robot moves.")
        self._since = time.monotonic()

    def _say(self, page: _Page, words: str) -> None:
        page.browser.say("\n".join([words, *self._messages[-N_MESSAGES:]]))


class _Page(NamedTuple):
    """What shows an acquisition, of which `n_before` images were taken before."""

    browser: Browser
    history: History
    way: Way
    n_before: int

    def n_left(self, shot: Shot) -> int:
        return len(self.way.plan.poses) - len(shot.taken) - len(shot.refused)

    def show(self, shot: Shot) -> None:
        at = self.way.camera_at(shot.T_world)
        look = Look(
            shot.image,
            at,
            self.history.setting.dofs_at(at),
            np.full(6, np.nan),
            self.way.after(shot.taken, shot.refused),
            words=f"{as_text(at)} from the reference, as the robot reports.",
        )
        self.history.looks.append(look)
        self.browser.mark(shot.taken, shot.refused)
        self.browser.show(len(self.history.looks) - 1)

    def progress(self, shot: Shot, seconds: float) -> str:
        n_done, n_new, n_left = len(shot.taken), len(shot.taken) - self.n_before, self.n_left(shot)
        words = f"{n_done} of {len(self.way.plan.poses)} images are on disk"
        if n_new > 0 and n_left > 0:
            words += f"; about {_lasting(n_left * seconds / n_new)} left"
        return f"{words}."


def _lasting(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 90 else f"{seconds / 60:.0f} min"
