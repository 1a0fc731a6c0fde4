"""``servoscope view``."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from tyro.conf import Positional, arg

from servoscope.commands.position import (
    CameraSpec,
    ConditionName,
    Log,
    Robot,
    Start,
    is_own,
    recorded_cell,
    simulated_cell,
)
from servoscope.errors import InvalidInputError

if TYPE_CHECKING:
    from servoscope.positioning import LoopSettings, PositioningModel
    from servoscope.viewer.browser import Browser
    from servoscope.viewer.history import History

Shown = Positional[
    Annotated[Path, arg(metavar="PATH", help="Log of a run, data set folder, or model folder.")]
]
OfModel = Annotated[
    Path | None,
    arg(metavar="FOLDER", help="Model of a log or a data set, whose relief is shown as well."),
]

_RECORDED = "recorded:"


class _Cell(NamedTuple):
    """What is run in, how the loop is set there, and the true displacement, if it is known."""

    robot: Any
    camera: Any
    settings: LoopSettings
    truth: Callable[[], Any] | None = None


def view(
    path: Shown,
    model: OfModel = None,
    robot: Robot = None,
    camera: CameraSpec = None,
    rehearse: bool = False,
    start: Start = None,
    condition: ConditionName = "range_1.0",
    seed: int = 0,
    max_moves: int = 12,
    tolerance_mm: float | None = None,
    tolerance_deg: float | None = None,
    max_step_mm: float | None = None,
    max_step_deg: float | None = None,
    log: Log = None,
    host: str = "127.0.0.1",
    port: int = 8080,
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
        seed: Seed of the start and of the noise.
        max_moves: Moves after which the loop gives up.
        tolerance_mm: Distance from the reference to get under; by default as near as the noise
            and the robot allow.
        tolerance_deg: Angle to get under.
        max_step_mm: Longer steps are cut to this; by default the farthest that the model was made
            for.
        max_step_deg: The same for their rotation.
        host: Address that is listened at; this machine alone can reach the default. Whoever
            reaches it can press the buttons.
        port: Port that is listened at; the next free one if it is in use.
    """
    from servoscope.positioning import LoopSettings, PositioningModel
    from servoscope.storage.model_folder import is_model
    from servoscope.viewer.browser import Browser

    if not is_model(path):
        if rehearse or robot is not None or log is not None:
            raise InvalidInputError(
                f"A run needs a model, but {path} is none; leave --robot, --rehearse and --log "
                "out, or name a model folder."
            )
        _replay(_history(path, model), partial(Browser, host=host, port=port))
        return
    if model is not None:
        raise InvalidInputError(f"{path} is a model itself; leave --model out.")
    settings = LoopSettings(
        max_moves=max_moves,
        tolerance_mm=tolerance_mm,
        tolerance_deg=tolerance_deg,
        max_step_mm=max_step_mm,
        max_step_deg=max_step_deg,
    )
    trained = PositioningModel.load(path)
    if rehearse:
        opened = _rehearsed(trained, path, robot, condition, seed, start, settings)
    else:
        opened = _opened(trained, robot, camera, condition, seed, start, settings)
    with opened as cell:
        _run(trained, cell, log, partial(Browser, host=host, port=port))


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


def _replay(history: History, open_browser: Callable[[History], Browser]) -> None:
    from servoscope.viewer.replay import Replay

    with _serving(open_browser(history)) as browser:
        replay = Replay(history, browser.show)
        browser.command(replay)
        browser.say(history.end)
        replay.seek(0)
        replay.until_closed()


def _run(
    model: PositioningModel,
    cell: _Cell,
    log: Path | None,
    open_browser: Callable[[History], Browser],
) -> None:
    """Run the loop as the buttons command, and show how it was until Ctrl-C."""
    from servoscope.commands.output import print_message
    from servoscope.positioning import Positioner
    from servoscope.positioning.run_log import RunLog
    from servoscope.viewer.history import History, Setting
    from servoscope.viewer.live import LiveRun

    positioner = Positioner(model, cell.settings)
    history = History(Setting.of_estimator(model), knows_truth=cell.truth is not None)
    with _serving(open_browser(history)) as browser:
        run_log = None if log is None else RunLog(log, positioner)
        live = LiveRun(
            positioner, cell.robot, cell.camera, history, browser.show, browser.say,
            truth=cell.truth, on_step=None if run_log is None else run_log.write,
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


def wait_for_ctrl_c() -> None:
    """Wait until Ctrl-C is pressed, also where waiting without an end does not hear it."""
    forever = threading.Event()
    while not forever.wait(1.0):
        pass


@contextmanager
def _serving(browser: Browser) -> Iterator[Browser]:
    """Say where the browser is, and close it at the end, which Ctrl-C is."""
    from servoscope.commands.output import print_message

    print_message(f"Open {browser.address} in a browser; Ctrl-C ends.")
    if not browser.is_of_this_machine:
        print_message(
            f"servoscope: warning: whoever reaches {browser.address} can press the buttons."
        )
    try:
        with suppress(KeyboardInterrupt):
            yield browser
    finally:
        browser.close()


@contextmanager
def _opened(
    model: PositioningModel,
    robot: str | None,
    camera: str | None,
    condition: str,
    seed: int,
    start: str | None,
    settings: LoopSettings,
) -> Iterator[_Cell]:
    """A robot of the user's own where it stands, or a recorded or simulated one at a start."""
    from servoscope.poses import inverse_transform
    from servoscope.robots.devices import closing, open_both
    from servoscope.scene.scene import T_WORLD_REF

    _check_condition(condition)
    if robot is not None and is_own(robot):
        if start is not None or condition != "range_1.0":
            raise InvalidInputError(
                "A robot of your own starts where it stands; leave --start and --condition out."
            )
        own, eye = open_both(robot, camera)
        with closing(own, eye):
            yield _Cell(own, eye, settings)
        return
    if camera is not None:
        raise InvalidInputError("--camera is of robots of your own; leave it out.")
    if robot is not None and robot.startswith(_RECORDED):
        if condition != "range_1.0":
            raise InvalidInputError(
                "--condition is of simulated cells; leave it out with recorded images."
            )
        folder = Path(robot.removeprefix(_RECORDED))
        recorded, T_ref = recorded_cell(model, folder, start, seed)
        coarse = settings.for_poses_apart(*recorded.spacing())
        yield _Cell(
            recorded, recorded, coarse, lambda: inverse_transform(T_ref) @ recorded.true_pose
        )
        return
    cell = simulated_cell(model, robot, condition, seed, start)
    if model.trained_on["robot"] != "free":  # it reports another frame than its camera's
        yield _Cell(cell, cell, settings)
        return
    yield _Cell(cell, cell, settings, lambda: inverse_transform(T_WORLD_REF) @ cell.true_pose)


@contextmanager
def _rehearsed(
    model: PositioningModel,
    path: Path,
    robot: str | None,
    condition: str,
    seed: int,
    start: str | None,
    settings: LoopSettings,
) -> Iterator[_Cell]:
    """A robot over the model's own view."""
    import numpy as np

    from servoscope.commands.position import number
    from servoscope.rehearsal.rendered_cell import cell_at_start
    from servoscope.rehearsal.run import Rehearsal, as_keyframe_model, check_conditions
    from servoscope.scoreboard.cell import CONDITIONS

    if robot is not None:
        raise InvalidInputError("A rehearsal has a robot of its own; leave --robot out.")
    check_conditions([condition])
    rehearsal = Rehearsal(as_keyframe_model(model, str(path)), seed=seed)
    first = 0 if start is None else number(start, "a number from 0")
    cell = cell_at_start(
        rehearsal.model, rehearsal.errors, rehearsal.ranges, condition, seed, first
    )
    scatter = CONDITIONS[condition].repeatability
    settings = replace(
        settings,
        repeatability_mm=1e3 * scatter.position,
        repeatability_deg=float(np.degrees(scatter.rotation)),
    )
    yield _Cell(cell, cell, settings, lambda: cell.true_pose)


def _check_condition(condition: str) -> None:
    from servoscope.scoreboard.cell import CONDITIONS

    if condition not in CONDITIONS:
        raise InvalidInputError(
            f"--condition must be one of {', '.join(CONDITIONS)}, got {condition!r}."
        )
