"""``servoscope position``."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from tyro.conf import arg

from servoscope.commands.cells import Cell, CellOptions, InCell, Loop, LoopOptions
from servoscope.commands.options import Json, Model
from servoscope.errors import ServoscopeError, ServoscopeWarning

if TYPE_CHECKING:
    from servoscope.positioning import Positioner, PositioningModel, PositioningResult
    from servoscope.positioning.result import Step

Log = Annotated[Path | None, arg(metavar="FOLDER", help="New folder to log the run to.")]
Replay = Annotated[
    Path | None, arg(metavar="FOLDER", help="Show the images of a log to the model instead.")
]
DryRun = Annotated[
    bool, arg(aliases=["--preview"], help="Look once and say the move, without making it.")
]
_DONE = ("converged", "dry_run")


def position(
    model: Model,
    cell: InCell = CellOptions(),  # noqa: B008
    loop: Loop = LoopOptions(),  # noqa: B008
    dry_run: DryRun = False,
    yes: bool = False,
    log: Log = None,
    replay: Replay = None,
    json: Json = False,
) -> None:
    """Bring the camera of a robot back to the reference that a model was trained on.

    A simulated robot starts within +-25 mm and +-15 deg about the pivot, or as the condition says,
    in the degrees of freedom that the model commands; the robot is moved in no others. With
    recorded:FOLDER the loop runs on your own images instead: the robot goes to the nearest of the
    recorded poses. A robot of your own starts where it stands, moves after one question, and is
    stopped at the end and by Ctrl-C; see docs/robots.md.

    Example: servoscope position model --robot arm --condition gain_0.8 --seed 3

    Example: servoscope position model --robot recorded:desk --seed 3

    Example: servoscope position model --robot ur:192.0.2.7 --camera opencv:0 --max-step-mm 20

    Args:
        yes: Let a robot of your own move without a question.
    """
    from servoscope.commands.output import print_json
    from servoscope.positioning import Positioner, PositioningModel

    cell.check()
    trained = PositioningModel.load(model)
    if replay is not None:
        facts = _replayed(trained, replay)
        print_json(facts) if json else _print_replayed(facts)
        return
    with cell.opened(trained, loop.settings(trained)) as opened:
        positioner, truth = Positioner(trained, opened.settings), None
        if opened.T_ref is None:
            result = _run_own(positioner, opened, dry_run, yes, log)
        else:
            result, truth = _run_known(positioner, opened, dry_run, log)
    facts = result.to_dict() | ({} if truth is None else {"true_error": truth.camera})
    print_json(facts) if json else _print_run(result, truth)
    _end(result)


def _end(result: PositioningResult) -> None:
    """End the command as the run ended."""
    if result.status == "interrupted":
        raise KeyboardInterrupt
    if result.status not in _DONE:
        raise ServoscopeError(f"{result.status}: {result.message}")


class _Truth(NamedTuple):
    """What is true of a run in a cell that is known.

    Parameters
    ----------
    looks : list of ndarray of shape (4, 4)
        Displacement at every look, of the frame that the robot reports, [m].
    end : ndarray of shape (6,)
        Displacement at the end, about the pivot, [m] and [rad].
    camera : dict
        How far the camera is from the reference at the end, in mm and deg.
    """

    looks: list[Any]
    end: Any
    camera: dict[str, float]


def _run_known(
    positioner: Positioner, cell: Cell, dry_run: bool, log: Path | None
) -> tuple[PositioningResult, _Truth]:
    """The run, and what is true at every look and at the end."""
    import numpy as np

    from servoscope.poses import displacements_from_poses, pose_error

    looks: list[Any] = []
    result = _logged_run(
        positioner, cell, dry_run, log, lambda step, image: looks.append(cell.true_displacement())
    )
    distance, angle = pose_error(cell.T_ref, cell.robot.true_pose)
    camera = {"mm": 1e3 * float(distance), "deg": float(np.degrees(angle))}
    end, pivot = cell.true_displacement()[None], positioner.estimator.pivot
    return result, _Truth(looks, displacements_from_poses(np.eye(4), end, pivot)[0], camera)


def _run_own(
    positioner: Positioner, cell: Cell, dry_run: bool, yes: bool, log: Path | None
) -> PositioningResult:
    """The run of a robot of the user's own, after one question.

    Raises
    ------
    ServoscopeError
        If the user does not agree.
    """
    from servoscope.commands.output import confirmed
    from servoscope.commands.streams import print_message

    refusal: list[ServoscopeError] = []
    is_confirmed = dry_run

    def ask(step: Step, image: Any) -> None:
        nonlocal is_confirmed
        if is_confirmed or step.commanded is None:
            return
        print_message(_first_move(step.commanded, positioner))
        try:
            is_confirmed = confirmed("Move the robot?", yes)
        except ServoscopeError as error:
            refusal.append(error)
            raise
        if not is_confirmed:
            refusal.append(ServoscopeError("Not confirmed; nothing was moved."))
            raise refusal[0]

    result = _logged_run(positioner, cell, dry_run, log, ask)
    if refusal:
        raise refusal[0]
    return result


def _first_move(commanded: Any, positioner: Positioner) -> str:
    """What the first move is, and the most that may follow."""
    import numpy as np

    from servoscope.poses import DISPLAY_FACTORS, displacements_from_poses

    x, y, z, rx, ry, rz = (
        DISPLAY_FACTORS * displacements_from_poses(np.eye(4), commanded[None], 0.0)[0]
    )
    estimator, settings = positioner.estimator, positioner.settings
    length, angle = settings.step_limits(estimator.reach, estimator.pivot)
    box = DISPLAY_FACTORS * settings.workspace(estimator.reach, estimator.pivot)
    sides = ", ".join("any" if np.isinf(side) else f"{side:.0f}" for side in box)
    fence = settings.robot_box(estimator)
    inside = f", and within {fence} of the robot's coordinates" if fence.is_limited else ""
    return (
        f"The first move is {x:+.1f}, {y:+.1f}, {z:+.1f} mm along and {rx:+.1f}, {ry:+.1f}, "
        f"{rz:+.1f} deg about the axes of the frame that the robot reports. There are at most "
        f"{settings.max_moves} moves, none longer than {1e3 * length:.0f} mm or "
        f"{np.degrees(angle):.0f} deg, all within {sides} (mm, deg) of where it stands{inside}."
    )


def _logged_run(
    positioner: Positioner,
    cell: Cell,
    dry_run: bool,
    log: Path | None,
    on_step: Callable[[Step, Any], None],
) -> PositioningResult:
    from servoscope.positioning.run_log import RunLog

    run_log = None if log is None else RunLog(log, positioner)

    def note(step: Step, image: Any) -> None:
        if run_log is not None:
            run_log.write(step, image)
        on_step(step, image)

    result = positioner.run(cell.robot, cell.camera, dry_run=dry_run, on_step=note)
    if run_log is not None:
        try:
            run_log.finish(result)
        except OSError as error:
            reason = f"The end of the run is not in its log, which cannot be written: {error}."
            warnings.warn(reason, ServoscopeWarning, stacklevel=2)
    return result


def _print_run(result: PositioningResult, truth: _Truth | None = None) -> None:
    """Print the looks, and what is believed of the end; and what is true, where that is known."""
    import numpy as np
    from rich.table import Table

    from servoscope.commands.output import console

    truths = [None] * len(result.steps) if truth is None else truth.looks
    table = Table(box=None, pad_edge=False)
    far = ("believed [mm, deg]", *(() if truth is None else ("true [mm, deg]",)))
    for column in ("look", "answered by", *far, "novelty", "matched", "ms"):
        table.add_column(column, justify="left" if column == "answered by" else "right")
    for number, (step, true) in enumerate(zip(result.steps, truths, strict=False)):
        table.add_row(
            str(number + 1),
            step.estimate.stage,
            _far(step.estimate.displacement),
            *([] if true is None else [_far(true)]),
            f"{step.estimate.novelty:.2f}",
            "-" if step.comparison is None else f"{step.comparison.matched:.0%}",
            f"{1e3 * step.seconds:.0f}",
        )
    out = console()
    out.print(table)
    if np.isfinite(result.predicted_error).any():
        out.print("predicted error about the pivot:", _by_dof(result.predicted_error, result.dofs))
    if truth is not None:
        out.print("true error about the pivot:", _by_dof(np.abs(truth.end), result.dofs))
        camera = truth.camera
        out.print(f"true error of the camera: {camera['mm']:.3f} mm, {camera['deg']:.3f} deg")
    if result.status in _DONE:  # any other end is said on standard error
        out.print(f"{result.status}: {result.message}")


def _far(displacement: Any) -> str:
    import numpy as np

    from servoscope.poses import pose_error

    distance, angle = pose_error(np.eye(4), displacement)
    return f"{1e3 * distance:.3f} {np.degrees(angle):6.3f}"


def _by_dof(errors: Any, dofs: Sequence[str]) -> str:
    from servoscope.poses import DISPLAY_FACTORS, DISPLAY_UNITS, DOFS

    shown = zip(DOFS, DISPLAY_FACTORS * errors, DISPLAY_UNITS, strict=True)
    return ", ".join(f"{dof} {e:.3f} {unit}" for dof, e, unit in shown if dof in dofs)


def _replayed(model: PositioningModel, folder: Path) -> dict[str, Any]:
    import numpy as np

    from servoscope.positioning.run_log import replay

    looks = [
        {
            "logged": look.logged.stage,
            "now": look.now.stage,
            "differs": look.differs,
            "mm": 1e3 * look.distance,
            "deg": float(np.degrees(look.angle)),
        }
        for look in replay(folder, model)
    ]
    return {"log": str(folder), "looks": looks}


def _print_replayed(facts: dict[str, Any]) -> None:
    from servoscope.commands.output import console

    out = console()
    for number, look in enumerate(facts["looks"]):
        said = f"differs by {look['mm']:.3f} mm, {look['deg']:.3f} deg" * look["differs"] or "same"
        out.print(f"look {number + 1}: {look['logged']}, now {look['now']}: {said}")
