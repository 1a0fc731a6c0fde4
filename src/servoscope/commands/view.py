"""``servoscope view``."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from servoscope.commands.cells import Cell, CellOptions, InCell, Loop, LoopOptions
from servoscope.commands.page import Page, PageOptions, wait_for_ctrl_c
from servoscope.commands.position import Log
from servoscope.errors import InvalidInputError

if TYPE_CHECKING:
    from servoscope.positioning import LoopSettings, PositioningModel
    from servoscope.viewer.history import History

Shown = Positional[
    Annotated[Path, arg(metavar="PATH", help="Log of a run, data set folder, or model folder.")]
]
OfModel = Annotated[
    Path | None,
    arg(metavar="FOLDER", help="Model of a log or a data set, whose relief is shown as well."),
]


def view(
    path: Shown,
    model: OfModel = None,
    rehearse: bool = False,
    cell: InCell = CellOptions(),  # noqa: B008
    loop: Loop = LoopOptions(),  # noqa: B008
    log: Log = None,
    page: Page = PageOptions(),  # noqa: B008
) -> None:
    """Show a run in a browser: the camera in space, its images, and what is believed.

    A log of position --log is gone through look by look; a data set is shown with the poses that
    the robot reported. With a model the loop runs, as in servoscope position: it takes an image,
    shows the move that it would make, and waits. The robot moves when Step or Run is pressed, and
    Stop stops it. Ctrl-C ends it all.

    Example: servoscope view run --model model

    Example: servoscope view model --robot ur:192.0.2.7 --camera opencv:0 --max-step-mm 20

    Example: servoscope view model --rehearse --condition covered_20

    Args:
        rehearse: Run on images that are rendered of the model's own view.
    """
    from servoscope.positioning import PositioningModel
    from servoscope.storage.model_folder import is_model

    if not is_model(path):
        if rehearse or cell.robot is not None or log is not None:
            raise InvalidInputError(
                f"A run needs a model, but {path} is none; leave --robot, --rehearse and --log "
                "out, or name a model folder."
            )
        _replay(_history(path, model), page)
        return
    if model is not None:
        raise InvalidInputError(f"{path} is a model itself; leave --model out.")
    trained = PositioningModel.load(path)
    settings = loop.settings(trained)
    if rehearse:
        opened = _rehearsed(trained, path, cell, settings)
    else:
        opened = cell.opened(trained, settings)
    with opened as of_robot:
        _run(trained, of_robot, log, page)


def _history(path: Path, model: Path | None) -> History:
    from servoscope.data.folder import is_data_set
    from servoscope.data.images import PoseImageSet
    from servoscope.positioning.model import PositioningModel
    from servoscope.viewer.history import History
    from servoscope.viewer.replay import read_log

    estimator = None if model is None else PositioningModel.load(model)
    if is_data_set(path):
        return History.of_data_set(PoseImageSet.load(path), estimator)
    if not (path / "run.json").exists():
        raise InvalidInputError(
            f"{path} is not the log of a run, a data set folder or a model folder; name one of "
            "these."
        )
    return read_log(path, estimator)


def _replay(history: History, page: PageOptions) -> None:
    from servoscope.viewer.replay import Replay

    with page.served(history) as browser:
        replay = Replay(history, browser.show)
        browser.command(replay)
        browser.say(history.end)
        replay.seek(0)
        replay.until_closed()


def _run(
    model: PositioningModel,
    cell: Cell,
    log: Path | None,
    page: PageOptions,
) -> None:
    """Run the loop as the buttons command, and show how it was until Ctrl-C."""
    from servoscope.commands.streams import print_message
    from servoscope.positioning import Positioner
    from servoscope.positioning.run_log import RunLog
    from servoscope.viewer.history import History, Setting
    from servoscope.viewer.live import LiveRun

    positioner = Positioner(model, cell.settings)
    truth = None if cell.T_ref is None else cell.true_displacement
    history = History(Setting.of_estimator(model), knows_truth=truth is not None)
    with page.served(history) as browser:
        run_log = None if log is None else RunLog(log, positioner)
        live = LiveRun(
            positioner, cell.robot, cell.camera, history, browser.show, browser.say,
            truth=truth, on_step=None if run_log is None else run_log.write,
        )  # fmt: skip
        browser.command(live)
        result = live.until_end()
        print_message(history.end)
        browser.allow(step=False, run=False)
        if run_log is not None:
            run_log.finish(result)
        if result.status == "interrupted" and not live.was_stopped:
            return  # by Ctrl-C, which ends the command too
        wait_for_ctrl_c()


@contextmanager
def _rehearsed(
    model: PositioningModel, path: Path, cell: CellOptions, settings: LoopSettings
) -> Iterator[Cell]:
    """A robot over the model's own view."""
    import numpy as np

    from servoscope.rehearsal.rendered_cell import cell_at_start
    from servoscope.rehearsal.run import Rehearsal, as_keyframe_model, check_conditions
    from servoscope.scoreboard.cell import CONDITIONS

    if cell.robot is not None:
        raise InvalidInputError("A rehearsal has a robot of its own; leave --robot out.")
    cell.check()
    check_conditions([cell.condition])
    rehearsal = Rehearsal(as_keyframe_model(model, str(path)), seed=cell.seed)
    rendered = cell_at_start(
        rehearsal.model, rehearsal.errors, rehearsal.ranges, cell.condition, cell.seed,
        cell.number(),
    )  # fmt: skip
    scatter = CONDITIONS[cell.condition].repeatability
    settings = replace(
        settings,
        repeatability_mm=1e3 * scatter.position,
        repeatability_deg=float(np.degrees(scatter.rotation)),
    )
    yield Cell(rendered, rendered, settings, np.eye(4))
