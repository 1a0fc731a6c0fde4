"""``servoscope acquire``."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import arg, create_mutex_group

from servoscope.commands.options import DataSetOut, Dofs, Force, Jobs, Json, Part
from servoscope.commands.page import Page, PageOptions, wait_for_ctrl_c
from servoscope.errors import InvalidInputError, ServoscopeError

if TYPE_CHECKING:
    from pathlib import Path

    from servoscope.acquisition.plan import Plan
    from servoscope.acquisition.recording import RecordingConfig
    from servoscope.viewer.acquisition import LiveAcquisition

IMAGES_OR_RINGS = create_mutex_group(required=False)
"""A schedule says how many images to take, so only one of the two can be asked for."""

Robot = Annotated[
    str,
    arg(
        metavar="ROBOT",
        help="free or arm, which are simulated, or a robot of your own, such as module:Class or "
        "ur:192.0.2.7, standing at the reference: docs/robots.md.",
    ),
]
Camera = Annotated[
    str | None,
    arg(metavar="CAMERA", help="What the robot carries, such as opencv:0 or module:Class."),
]
View = Annotated[
    bool,
    arg(
        help="Show the plan and the images in a browser; its buttons Step and Run let the robot "
        "move, in place of the question, and Stop stops it."
    ),
]
Yes = Annotated[bool, arg(help="Move the robot without asking.")]


def acquire(
    out: DataSetOut,
    n_images: Annotated[int | None, IMAGES_OR_RINGS] = None,
    schedule: Annotated[str | None, IMAGES_OR_RINGS] = None,
    until: str | None = None,
    image_size: int = 256,
    seed: int = 0,
    part: Part = "cylinder_head",
    variant: int = 0,
    robot: Robot = "free",
    camera: Camera = None,
    preview: bool = False,
    yes: Yes = False,
    view: View = False,
    page: Page = PageOptions(),  # noqa: B008
    workspace: str = "",
    max_step_mm: float = 50.0,
    max_step_deg: float = 10.0,
    check_every: int = 50,
    settle_s: float = 5.0,
    dofs: Dofs = None,
    translation_mm: float = 25.0,
    rotation_deg: float = 15.0,
    pivot_mm: float = 550.0,
    repeatability_mm: float = 0.05,
    repeatability_deg: float = 0.01,
    jobs: Jobs = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Take images of a part at random poses around the reference, with a robot or simulated.

    A robot of your own stands at the reference when the command is given. What it will do is said
    before it moves: how far from there, in how many steps, and how long it takes; --preview ends
    there, and draws the way in OUT/plan.png. Every image is on disk before it moves on, and it
    returns to the reference at the end. The simulated reference looks straight down on the part
    from 550 mm. An interrupted acquisition goes on where it stopped when the same command is given
    again.

    Example: servoscope acquire head --n-images 1000 --image-size 256 --seed 0

    Example: servoscope acquire cell --until t=0.1mm,r=0.02deg

    Example: servoscope acquire rings --schedule 1000@1.0,400@0.2,400@0.03

    Example: servoscope acquire gantry --schedule 40@1.6 --dofs tx,ty,rz

    Example: servoscope acquire plane --schedule 40@1.6 --part textured_plane --robot arm

    Example: servoscope acquire part --robot ur:192.0.2.7 --camera opencv:0 --pivot-mm 300 --preview

    Example: servoscope acquire part --robot my_cell:Robot --camera my_cell:Camera --n-images 40
        --translation-mm 10 --rotation-deg 5 --workspace x=300:700,y=-200:200,z=150:600

    Args:
        n_images: Number of images, drawn from the whole range; 1000 by default. With --until,
            the most that are taken; 100 by default. Of a robot of your own 40, drawn from 1.6
            times the range.
        schedule: Rings to take instead, IMAGES@FACTOR each, FACTOR being the share of the range
            that a ring is drawn from; "default" takes those recommended for positioning.
        until: Largest median error of one look from anywhere in the range. Images are taken where
            most is learned of the view, until the forecast meets it.
        image_size: Height and width of the images, in pixels.
        seed: Seed of the poses and of the noise.
        variant: Another number, from 0, gives another part of the kind.
        translation_mm: Largest displacement along each axis, in mm.
        rotation_deg: Largest rotation about each axis, in degrees.
        pivot_mm: Distance of the centre of rotation, where the part is, along z of the camera, or
            of the frame that a robot of your own reports, in mm.
        preview: Say what the robot would do, and do nothing.
        workspace: A box that the reported frame never leaves, in mm of the robot's coordinates,
            such as x=300:700,z=150:600.
        max_step_mm: Longer ways are gone in steps of at most so much.
        max_step_deg: The same for rotations.
        check_every: After so many images the reference is looked at again.
        settle_s: How long the view may take to come to rest after a move.
        repeatability_mm: Standard deviation of the robot's position error, in mm.
        repeatability_deg: Standard deviation of the robot's rotation error, in degrees.
    """
    from servoscope.acquisition import AcquisitionConfig
    from servoscope.acquisition import acquire as acquire_images
    from servoscope.commands.info import print_data_set
    from servoscope.commands.options import n_jobs
    from servoscope.commands.output import progress_bar
    from servoscope.commands.streams import print_message
    from servoscope.data.schedule import parse_schedule
    from servoscope.dofs import parse_accuracy, parse_dofs
    from servoscope.poses import DOFS
    from servoscope.positioning.workspace import Workspace
    from servoscope.robots.registry import ROBOTS

    rings = () if schedule is None else parse_schedule(schedule)
    wanted = DOFS if dofs is None else parse_dofs(dofs)
    box = Workspace.parse(workspace)
    shown = page if view else None
    if robot not in ROBOTS:
        if ":" not in robot:
            raise InvalidInputError(
                f"--robot must be one of {', '.join(ROBOTS)}, which are simulated, or a robot of "
                f"your own such as module:Class, got {robot!r}."
            )
        if until is not None:
            raise InvalidInputError(
                "--until is for simulated robots; leave it out, and add images later if need be."
            )
        settings: dict[str, Any] = {
            "n_images": n_images, "schedule": rings, "seed": seed, "dofs": wanted,
            "translation_mm": translation_mm, "rotation_deg": rotation_deg, "pivot_mm": pivot_mm,
            "workspace": box, "max_step_mm": max_step_mm, "max_step_deg": max_step_deg,
            "check_every": check_every, "settle_s": settle_s,
        }  # fmt: skip
        if preview:
            from servoscope.acquisition.recording import RecordingConfig

            _preview_own(out, robot, RecordingConfig(**settings), shown, json)
            return
        with _said_if_whole(out, force):
            _take(out, robot, camera, settings, yes=yes, force=force, page=shown)
        print_data_set(out, as_json=json)
        return
    if view and not preview:
        raise InvalidInputError(
            "--view is of a robot of your own, and of plans; give --preview with it."
        )
    request = None if until is None else parse_accuracy(until)
    if request is not None:
        from servoscope.acquisition.until import FIRST, MOST_IMAGES, acquire_until

        if schedule is not None:
            raise InvalidInputError("--until finds out which images to take; leave --schedule out.")
        n_images = MOST_IMAGES if n_images is None else n_images
        if n_images < FIRST:
            raise InvalidInputError(
                f"--until needs at least {FIRST} images, got --n-images {n_images}."
            )
    config = AcquisitionConfig(
        n_images=n_images,
        image_size=image_size,
        seed=seed,
        translation_mm=translation_mm,
        rotation_deg=rotation_deg,
        pivot_mm=pivot_mm,
        repeatability_mm=repeatability_mm,
        repeatability_deg=repeatability_deg,
        schedule=rings,
        part=part,
        variant=variant,
        robot=robot,
        dofs=wanted,
    )
    if preview:
        from servoscope.acquisition.plan import Plan

        T_world_ref = config.reference()
        pivot = config.pivot(T_world_ref)
        _show(Plan.draw(config.draws(), T_world_ref, pivot=pivot, workspace=box), out, shown, json)
        return
    with _said_if_whole(out, force), progress_bar("images", config.total()) as advance:
        if request is None:
            acquire_images(out, config, n_jobs=n_jobs(jobs), force=force, on_progress=advance)
        else:
            acquire_until(
                out, config, request, n_jobs=n_jobs(jobs), force=force, on_progress=advance,
                on_standing=lambda standing: print_message(str(standing)),
            )  # fmt: skip
    print_data_set(out, as_json=json)


@contextmanager
def _said_if_whole(out: Path, force: bool) -> Iterator[None]:
    """Say in the end that nothing was taken where the data set was there, and was asked for so."""
    from servoscope.commands.streams import print_message
    from servoscope.data.folder import is_finished

    is_whole = is_finished(out) and not force
    yield
    if is_whole:
        print_message(f"{out} is whole already: nothing was taken; --force takes it anew.")


def _preview_own(
    out: Path, robot: str, config: RecordingConfig, page: PageOptions | None, json: bool
) -> None:
    """Say where a robot of one's own would go."""
    from servoscope.acquisition.recording import preview
    from servoscope.robots.devices import closing, open_robot

    device = open_robot(robot)
    with closing(device):
        plan = preview(device, config)
    _show(plan, out, page, json)


def _take(
    out: Path,
    robot: str,
    camera: str | None,
    settings: dict[str, Any],
    *,
    yes: bool,
    force: bool,
    page: PageOptions | None,
) -> None:
    """Take images with a robot of one's own."""
    from servoscope.acquisition.recording import RecordingConfig, acquire_from
    from servoscope.commands.output import confirmed, progress_bar
    from servoscope.commands.streams import print_message
    from servoscope.errors import AcquisitionStoppedError
    from servoscope.robots.devices import closing, open_both

    config = RecordingConfig(**settings)
    device, taking = open_both(robot, camera)
    with closing(device, taking), ExitStack() as stack:
        live = None
        if page is not None:
            from servoscope.viewer.acquisition import LiveAcquisition

            live = stack.enter_context(_shown(LiveAcquisition(device, page.open, is_agreed=yes)))
        advances: list[Callable[[int], object]] = []

        def agreed(plan: Any) -> bool:
            print_message(str(plan))
            agrees = confirmed("Move the robot?", yes) if live is None else live.confirm(plan)
            if agrees:
                advances.append(stack.enter_context(progress_bar("images", config.total)))
            return agrees

        def say(message: str) -> None:
            print_message(message)
            if live is not None:
                live.on_message(message)

        try:
            acquire_from(
                device if live is None else live.robot, taking, out,
                force=force, confirm=agreed, on_message=say,
                on_progress=lambda n_done: advances[0](n_done),
                on_shot=None if live is None else live.on_shot, **settings,
            )  # fmt: skip
        except AcquisitionStoppedError as error:
            if isinstance(error.__cause__, KeyboardInterrupt):
                if live is None:
                    print_message(str(error))
                raise KeyboardInterrupt from error
            raise


@contextmanager
def _shown(live: LiveAcquisition) -> Iterator[LiveAcquisition]:
    """Show in the end how an acquisition ended, until Ctrl-C, unless that was what ended it."""
    from servoscope.commands.streams import print_message

    words, is_ended = "It failed; the terminal says why.", False
    try:
        yield live
        words = "All images are on disk; the robot is back at the reference."
    except KeyboardInterrupt as error:
        words, is_ended = str(error.__cause__ or "Interrupted."), not live.was_stopped
        raise
    except ServoscopeError as error:
        words = str(error)
        raise
    finally:
        live.finish(words)
        stays = live.is_shown and not is_ended
        print_message(f"{words}{' The page stays until Ctrl-C.' * stays}")
        if stays:
            with suppress(KeyboardInterrupt):
                wait_for_ctrl_c()
        live.close()


def _show(plan: Plan, out: Path, page: PageOptions | None, json: bool) -> None:
    """Print a plan, and draw it; in a browser until Ctrl-C, if there is to be a page."""
    from servoscope.commands.output import console, print_json

    out.mkdir(parents=True, exist_ok=True)
    picture = out / "plan.png"
    plan.save_picture(picture)
    if json:
        print_json({**plan.facts(), "picture": str(picture)})
    else:
        console().print(f"{plan}\nthe way is drawn in {picture}", markup=False, highlight=False)
    if page is not None:
        from servoscope.viewer.acquisition import planned

        with page.served(planned(plan)) as browser:
            browser.allow(step=False, run=False)
            browser.say(str(plan))
            wait_for_ctrl_c()
