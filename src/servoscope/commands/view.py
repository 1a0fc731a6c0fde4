"""``servoscope view``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

if TYPE_CHECKING:
    from servoscope.viewer.browser import Browser
    from servoscope.viewer.history import History

Shown = Positional[
    Annotated[Path, arg(metavar="PATH", help="Log of a run, data set folder, or model folder.")]
]
OfModel = Annotated[
    Path | None, arg(metavar="FOLDER", help="Model of the run, whose relief is shown as well.")
]


def view(
    path: Shown,
    model: OfModel = None,
    host: str = "127.0.0.1",
    port: int = 8080,
) -> None:
    """Show a run in a browser: the camera in space, its images, and what is believed.

    A log of position --log is gone through look by look; a data set is shown with the poses that
    the robot reported. Ctrl-C ends it.

    Example: servoscope position model --log run && servoscope view run --model model

    Args:
        host: Address that is listened at; this machine alone can reach the default. Whoever
            reaches it can press the buttons.
        port: Port that is listened at; the next free one if it is in use.
    """
    from servoscope.viewer.browser import Browser
    from servoscope.viewer.replay import Replay

    history = _history(path, model)
    browser = Browser(history, host, port)
    replay = Replay(history, browser.show)
    browser.command(replay)
    browser.say(history.end)
    replay.seek(0)
    _announce(browser, host)
    try:
        replay.until_closed()
    except KeyboardInterrupt:  # the way to end it
        pass
    finally:
        browser.close()


def _history(path: Path, model: Path | None) -> History:
    from servoscope.data.folder import is_data_set
    from servoscope.data.images import PoseImageSet
    from servoscope.positioning.model import PositioningModel
    from servoscope.viewer.history import History
    from servoscope.viewer.replay import read_log

    estimator = None if model is None else PositioningModel.load(model)
    if is_data_set(path):
        return History.of_data_set(PoseImageSet.load(path), estimator)
    return read_log(path, estimator)


def _announce(browser: Browser, host: str) -> None:
    from servoscope.commands.output import print_message

    print_message(f"Open {browser.address} in a browser; Ctrl-C ends.")
    if not browser.is_of_this_machine:
        print_message(f"servoscope: warning: whoever reaches {host} can press the buttons.")
