"""The page that a command serves, as options: where it is, and until when."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

from tyro.conf import OmitArgPrefixes

if TYPE_CHECKING:
    from servoscope.viewer.browser import Browser
    from servoscope.viewer.history import History


@dataclass(frozen=True)
class PageOptions:
    """Where the page is served.

    Args:
        host: Address that is listened at; this machine alone can reach the default. Whoever
            reaches it can press the buttons.
        port: Port that is listened at; the next free one if it is in use.
    """

    host: str = "127.0.0.1"
    port: int = 8080

    def open(self, history: History) -> Browser:
        """A page that shows a history; says where it is, and when nobody looks at it any more.

        Raises
        ------
        InvalidInputError
            If it cannot be served there.
        """
        from servoscope.commands.streams import print_message
        from servoscope.viewer.browser import Browser

        browser = Browser(history, self.host, self.port)
        browser.on_alone = lambda: print_message(
            "The page was closed: what was allowed goes on. Ctrl-C here ends it; the page is still "
            f"at {browser.address}."
        )
        print_message(f"Open {browser.address} in a browser; Ctrl-C ends.")
        if not browser.is_of_this_machine:
            print_message(
                f"servoscope: warning: whoever reaches {browser.address} can press the buttons."
            )
        return browser

    @contextmanager
    def served(self, history: History) -> Iterator[Browser]:
        """A page that is served until the end, which Ctrl-C is."""
        browser = self.open(history)
        try:
            with suppress(KeyboardInterrupt):
                yield browser
        finally:
            browser.close()


Page = OmitArgPrefixes[PageOptions]


def wait_for_ctrl_c() -> None:
    """Wait until Ctrl-C is pressed, also where waiting without an end does not hear it."""
    forever = threading.Event()
    while not forever.wait(1.0):
        pass
