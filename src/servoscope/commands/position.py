"""``servoscope position``."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import arg

from servoscope.commands.options import Json, Model
from servoscope.errors import InvalidInputError, ServoscopeError, ServoscopeWarning

if TYPE_CHECKING:
    from servoscope.positioning import Positioner, PositioningModel, PositioningResult
    from servoscope.positioning.result import Step
    from servoscope.robots.recorded import RecordedRobot
    from servoscope.robots.registry import SimulatedRobot


Log = Annotated[Path | None, arg(metavar="FOLDER", help="New folder to log the run to.")]
Replay = Annotated[
    Path | None, arg(metavar="FOLDER", help="Show the images of a log to the model instead.")
]
Robot = Annotated[
    str | None,
    arg(
        metavar="SPEC",
        help="The simulated robot that took the images of training (free, arm), which is the "
        "default; recorded:FOLDER, which goes to the nearest pose of a data set folder and shows "
        "the image taken there; your own, such as ur:192.0.2.7 or module:Class.",
    ),
]
CameraSpec = Annotated[
    str | None,
    arg(
        metavar="SPEC",
        help="What takes the images, of a robot of your own: opencv:0, folder:PATH, module:Class "
        "and others; by default the robot itself.",
    ),
]
Start = Annotated[
    str | None,
    arg(
        metavar="N",
        help="Number of the start that is drawn, or number or name of the recorded image to begin "
        "at; otherwise the first start of the seed.",
    ),
]
Tolerance = Annotated[
    str,
    arg(
        metavar="DOF=VALUE,...",
        help="Tolerances of single dofs about the pivot, such as tz=0.1mm,rz=0.02deg; t and r "
        "stand for all three of a kind.",
    ),
]
ConditionName = Annotated[
    str,
    arg(
        metavar="NAME",
        help="How the cell differs from the one of training: gain_0.8, light_moved, covered_10, "
        "noise_10 and others; a name that is none lists them all.",
    ),
]

_RECORDED = "recorded:"
_DONE = ("converged", "dry_run")


def position(
    model: Model,
    robot: Robot = None,
    camera: CameraSpec = None,
    start: Start = None,
    condition: ConditionName = "range_1.0",
    seed: int = 0,
    max_moves: int = 12,
    tolerance_mm: float | None = None,
    tolerance_deg: float | None = None,
    tolerance: Tolerance = "",
    repeatability_mm: float = 0.0,
    repeatability_deg: float = 0.0,
    max_step_mm: float | None = None,
    max_step_deg: float | None = None,
    workspace_margin: float = 1.6,
    workspace: str = "",
    execution_mm: float = 0.5,
    execution_deg: float = 0.1,
    least_similarity: float | None = None,
    final_images: int = 8,
    read_timeout_s: float = 5.0,
    first_read_timeout_s: float = 30.0,
    move_timeout_s: float = 60.0,
    dry_run: bool = False,
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
        seed: Seed of the start and of the noise.
        max_moves: Moves after which it gives up.
        tolerance_mm: Distance from the reference to get under; by default as near as the noise
            and the robot allow.
        tolerance_deg: Angle to get under.
        repeatability_mm: How far from where it is sent the robot comes to rest, if that is known.
        repeatability_deg: The same for its rotation.
        max_step_mm: Longer steps are cut to this; by default the farthest that the model was made
            for.
        max_step_deg: The same for their rotation.
        workspace: A box in mm of the robot's coordinates that the reported frame never leaves, such
            as x=300:700,z=150:600; by default that in which the images were taken.
        workspace_margin: The poses stay in a box around the start, so many times the range that
            the model was made for.
        execution_mm: A move may end so far from where it was sent, or a fifth of it if that is
            more.
        execution_deg: The same for its rotation.
        least_similarity: Least similarity of an image to what is expected, 0 to 1; by default
            what the model states.
        final_images: Images that are averaged where the camera seems to have arrived.
        read_timeout_s: How long an image or a pose may take.
        first_read_timeout_s: How long the first image may take.
        move_timeout_s: How long a move may take.
        dry_run: Look once and say the move, without making it.
        yes: Let a robot of your own move without a question.
    """
    from servoscope.commands.output import print_json
    from servoscope.dofs import parse_tolerances
    from servoscope.positioning import LoopSettings, Positioner, PositioningModel
    from servoscope.positioning.interfaces import dofs_of
    from servoscope.positioning.workspace import Workspace
    from servoscope.scene.scene import T_WORLD_REF
    from servoscope.scoreboard.cell import CONDITIONS

    if condition not in CONDITIONS:
        raise InvalidInputError(
            f"--condition must be one of {', '.join(CONDITIONS)}, got {condition!r}."
        )
    is_of_user = is_own(robot)
    if not is_of_user and camera is not None:
        raise InvalidInputError("--camera is of robots of your own; leave it out.")
    if is_of_user and (start is not None or condition != "range_1.0"):
        raise InvalidInputError(
            "A robot of your own starts where it stands; leave --start and --condition out."
        )
    trained = PositioningModel.load(model)
    if replay is not None:
        facts = _replayed(trained, replay)
        print_json(facts) if json else _print_replayed(facts)
        return
    settings = LoopSettings(
        max_moves=max_moves,
        tolerance_mm=tolerance_mm,
        tolerance_deg=tolerance_deg,
        tolerances=parse_tolerances(tolerance, dofs_of(trained)),
        repeatability_mm=repeatability_mm,
        repeatability_deg=repeatability_deg,
        max_step_mm=max_step_mm,
        max_step_deg=max_step_deg,
        workspace_margin=workspace_margin,
        robot_workspace=Workspace.parse(workspace) if workspace else None,
        execution_mm=execution_mm,
        execution_deg=execution_deg,
        least_similarity=least_similarity,
        final_images=final_images,
        read_timeout_s=read_timeout_s,
        first_read_timeout_s=first_read_timeout_s,
        move_timeout_s=move_timeout_s,
    )
    if robot is not None and is_of_user:
        result = _run_own(Positioner(trained, settings), robot, camera, dry_run, yes, log)
        facts = result.to_dict()
        print_json(facts) if json else _print_run(result)
        _end(result)
        return
    cell: RecordedRobot | SimulatedRobot
    if robot is not None and robot.startswith(_RECORDED):
        if condition != "range_1.0":
            raise InvalidInputError(
                "--condition is of simulated cells; leave it out with recorded images."
            )
        folder = Path(robot.removeprefix(_RECORDED))
        recorded, T_ref = recorded_cell(trained, folder, start, seed)
        cell, settings = recorded, settings.for_poses_apart(*recorded.spacing())
    else:
        cell, T_ref = simulated_cell(trained, robot, condition, seed, start), T_WORLD_REF
    result, distances = _run_known(Positioner(trained, settings), cell, T_ref, dry_run, log)
    if json:
        print_json({**result.to_dict(), "true_error": distances[-1]})
    else:
        _print_run(result, distances)
    _end(result)


def _end(result: PositioningResult) -> None:
    """End the command as the run ended."""
    if result.status == "interrupted":
        raise KeyboardInterrupt
    if result.status not in _DONE:
        raise ServoscopeError(f"{result.status}: {result.message}")


def is_own(robot: str | None) -> bool:
    """Whether a robot is the user's own, neither simulated nor recorded."""
    from servoscope.robots.devices import ROBOT_KINDS, forms
    from servoscope.robots.registry import ROBOTS

    if robot is None or robot in ROBOTS:
        return False
    kind, _, rest = robot.partition(":")
    if not (kind and rest):
        raise InvalidInputError(
            f"--robot must be {', '.join(ROBOTS)}, {forms(ROBOT_KINDS)}, got {robot!r}."
        )
    return f"{kind}:" != _RECORDED


def recorded_cell(
    model: PositioningModel, folder: Path, start: str | None, seed: int
) -> tuple[RecordedRobot, Any]:
    """A robot that lives in a recording of the model's reference, and the reference's pose."""
    import numpy as np

    from servoscope.data.images import PoseImageSet
    from servoscope.dofs import mask_of
    from servoscope.positioning.interfaces import dofs_of
    from servoscope.robots.recorded import RecordedRobot

    data = PoseImageSet.load(folder)
    if not np.array_equal(data.reference_image, model.reference_image):
        raise InvalidInputError(
            f"The reference image of {folder} is not the one that the model was trained on; "
            "import the recording with the same reference frame and image width."
        )
    if start is None:
        is_within = np.abs(data.delta_p()) <= model.reach
        within = np.flatnonzero(is_within[:, mask_of(dofs_of(model))].all(axis=1))
        if not within.size:
            raise InvalidInputError(
                f"No image of {folder} was taken within the range that the model was trained on; "
                "name one with --start, or record nearer to the reference."
            )
        frame = int(np.random.default_rng(seed).choice(within))
    elif start in data.names:
        frame = list(data.names).index(start)
    else:
        frame = number(start, f"the number or the name of an image of {folder}")
    return RecordedRobot(data, frame), data.T_world_ref


def number(start: str, wanted: str) -> int:
    """The whole number that ``--start`` is; `wanted` says what it is the number of."""
    if not (start.isascii() and start.isdigit() and len(start) < 10):
        raise InvalidInputError(f"--start must be {wanted}, got {start!r}.")
    return int(start)


def simulated_cell(
    model: PositioningModel, robot: str | None, condition: str, seed: int, start: str | None
) -> SimulatedRobot:
    """The robot and the part of training, at a start and under a condition."""
    from servoscope.poses import DOFS
    from servoscope.positioning.interfaces import dofs_of
    from servoscope.scoreboard.cell import PIVOT, robot_in_cell

    source, dofs = model.trained_on, dofs_of(model)
    if not {"part", "variant", "robot"} <= source.keys():
        raise InvalidInputError(
            "The model was not trained on simulated images, so that there is no simulated robot "
            "for it; give --robot recorded:FOLDER with the images, or see docs/positioning.md on "
            "how to run it on a robot of your own."
        )
    if robot not in (None, source["robot"]):
        raise InvalidInputError(
            f"The model was trained with --robot {source['robot']}, whose poses it reports; leave "
            f"--robot out, or train one on images acquired with --robot {robot}."
        )
    height, _ = model.image_shape
    return robot_in_cell(
        source["part"],
        source["variant"],
        source["robot"],
        condition,
        height,
        seed,
        0 if start is None else number(start, "a number from 0"),
        dofs,
        PIVOT if dofs == DOFS else 1e-3 * float(source.get("pivot_mm", 1e3 * PIVOT)),
    )


def _run_known(
    positioner: Positioner,
    cell: SimulatedRobot | RecordedRobot,
    T_ref: Any,
    dry_run: bool,
    log: Path | None,
) -> tuple[PositioningResult, list[dict[str, float]]]:
    """The run, and the true distance from the reference at every look and at the end."""
    import numpy as np

    from servoscope.poses import pose_error

    distances: list[dict[str, float]] = []

    def note(step: Any = None, image: Any = None) -> None:
        distance, angle = pose_error(T_ref, cell.true_pose)
        distances.append({"mm": 1e3 * float(distance), "deg": float(np.degrees(angle))})

    result = _logged_run(positioner, cell, cell, dry_run, log, note)
    note()
    return result, distances


def _run_own(
    positioner: Positioner,
    robot: str,
    camera: str | None,
    dry_run: bool,
    yes: bool,
    log: Path | None,
) -> PositioningResult:
    """The run of a robot of the user's own, after one question.

    Raises
    ------
    ServoscopeError
        If the robot or the camera cannot be opened, or the user does not agree.
    """
    from servoscope.commands.output import confirmed, print_message
    from servoscope.robots.devices import closing, open_both

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

    opened, eye = open_both(robot, camera)
    with closing(opened, eye):
        result = _logged_run(positioner, opened, eye, dry_run, log, ask)
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
    robot: Any,
    camera: Any,
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

    result = positioner.run(robot, camera, dry_run=dry_run, on_step=note)
    if run_log is not None:
        try:
            run_log.finish(result)
        except OSError as error:
            reason = f"The end of the run is not in its log, which cannot be written: {error}."
            warnings.warn(reason, ServoscopeWarning, stacklevel=2)
    return result


def _print_run(
    result: PositioningResult, distances: Sequence[dict[str, float]] | None = None
) -> None:
    """Print the looks, and what is believed of the end; and what is true, where that is known."""
    import numpy as np
    from rich.table import Table

    from servoscope.commands.output import console
    from servoscope.poses import DISPLAY_FACTORS, DISPLAY_UNITS, DOFS, pose_error

    n_looks = len(result.steps)
    truths = [None] * n_looks if distances is None else list(map(_far, distances))[:n_looks]
    table = Table(box=None, pad_edge=False)
    for column in ("look", "answered by", "believed", "true", "novelty", "matched", "ms"):
        if column != "true" or distances is not None:
            table.add_column(column, justify="left" if column == "answered by" else "right")
    for number, (step, truth) in enumerate(zip(result.steps, truths, strict=False)):
        distance, angle = pose_error(np.eye(4), step.estimate.displacement)
        table.add_row(
            str(number + 1),
            step.estimate.stage,
            f"{1e3 * distance:.3f} mm {np.degrees(angle):.3f} deg",
            *([] if truth is None else [truth]),
            f"{step.estimate.novelty:.2f}",
            "-" if step.comparison is None else f"{step.comparison.matched:.0%}",
            f"{1e3 * step.seconds:.1f}",
        )
    out = console()
    out.print(table)
    left = zip(DOFS, DISPLAY_FACTORS * result.predicted_error, DISPLAY_UNITS, strict=True)
    said = [f"{dof} {e:.3f} {unit}" for dof, e, unit in left if dof in result.dofs]
    if np.isfinite(result.predicted_error).any():
        out.print("predicted error about the pivot:", ", ".join(said))
    if distances is not None:
        out.print(f"true error: {distances[-1]['mm']:.3f} mm, {distances[-1]['deg']:.3f} deg")
    if result.status in _DONE:  # any other end is said on standard error
        out.print(f"{result.status}: {result.message}")


def _far(distance: dict[str, float]) -> str:
    return f"{distance['mm']:.3f} mm {distance['deg']:.3f} deg"


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
