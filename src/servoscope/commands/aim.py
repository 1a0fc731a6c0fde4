"""``servoscope aim``."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import arg

from servoscope.commands.options import Json, Model
from servoscope.errors import InvalidInputError, ServoscopeError

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

    from servoscope.positioning.aiming import Aim

Camera = Annotated[
    str,
    arg(
        metavar="SPEC",
        help="What takes the images: opencv:0, folder:PATH, ros:HOST:PORT?image=TOPIC, "
        "recorded:FOLDER or module:Class.",
    ),
]

_ARROWS = (("←", "→"), ("↑", "↓"), ("⊙", "⊗"), ("↓", "↑"), ("←", "→"), ("↺", "↻"))
_PLAIN_ARROWS = (("<", ">"), ("^", "v"), ("o", "x"), ("v", "^"), ("<", ">"), ("(", ")"))
_STYLES = {"aimed": "bold green", "move": "bold", "unrecognised": "bold red"}


def aim(
    model: Model,
    camera: Camera,
    tolerance_mm: float = 1.0,
    tolerance_deg: float = 0.2,
    least_similarity: float | None = None,
    once: bool = False,
    json: Json = False,
) -> None:
    """Say how a person has to move a camera, for it to be where it was: no robot is needed.

    The model knows the view that the camera had. What is shown is as seen from behind the camera,
    and new with every image, until Ctrl-C ends it.

    Example: servoscope aim model --camera opencv:0

    Example: servoscope aim model --camera recorded:cell --once --json

    Args:
        tolerance_mm: The camera is back if it is nearer than this to where it was.
        tolerance_deg: The same for its direction.
        least_similarity: Least similarity of an image to what is expected, 0 to 1; by default
            what the model states.
        once: Read one image, and end.
    """
    from servoscope.commands.output import console, print_json
    from servoscope.positioning import PositioningModel, aiming
    from servoscope.robots.devices import closing, open_camera

    if json and not once:
        raise InvalidInputError("--json prints one reading; give --once with it.")
    settings = replace(
        aiming.AIM_SETTINGS,
        tolerance_mm=tolerance_mm,
        tolerance_deg=tolerance_deg,
        least_similarity=least_similarity,
    )
    trained = PositioningModel.load(model)
    eye = open_camera(camera)
    with closing(eye):
        if not once:
            _watch(trained, eye, settings, console())
            return
        reading = aiming.aim(trained, _image(eye), settings)
    if json:
        print_json(reading.to_dict())
    else:
        out = console()
        out.print(_shown(reading, settings, out))
    if reading.status == "unrecognised":
        raise ServoscopeError(reading.message)


def _watch(model: Any, camera: Any, settings: Any, out: Console) -> None:
    """Show a reading of every image until Ctrl-C; where nothing can be drawn, a line for each."""
    from rich.live import Live

    from servoscope.positioning.aiming import aim as read

    reading: Aim | None = None
    try:
        if not out.is_terminal:
            while True:
                reading = read(model, _image(camera), settings, reading)
                words = ", ".join(reading.words())
                out.print(f"{reading.message} {words}".strip(), soft_wrap=True)
                out.file.flush()
        with Live(console=out, auto_refresh=False) as live:
            while True:
                reading = read(model, _image(camera), settings, reading)
                live.update(_shown(reading, settings, out), refresh=True)
    except KeyboardInterrupt:
        return


def _image(camera: Any) -> Any:
    """An image of a camera, whatever it raises said in a line."""
    from servoscope.errors import CameraFaultError
    from servoscope.wording import one_line

    try:
        return camera.read()
    except ServoscopeError:
        raise
    except Exception as error:
        raise CameraFaultError(f"The camera failed: {one_line(error)}") from error


def _shown(reading: Aim, settings: Any, out: Console) -> RenderableType:
    """A reading as a table of what to do, and what came of it below."""
    import numpy as np
    from rich.console import Group
    from rich.table import Table
    from rich.text import Text

    from servoscope.poses import DISPLAY_FACTORS, DISPLAY_UNITS, DOFS
    from servoscope.positioning.aiming import WORDS

    table = Table(box=None, show_header=False, pad_edge=False)
    arrows = _PLAIN_ARROWS if out.options.ascii_only else _ARROWS
    limits = (settings.tolerance_mm,) * 3 + (settings.tolerance_deg,) * 3
    shown, deviations = DISPLAY_FACTORS * reading.correction, DISPLAY_FACTORS * reading.std
    for i, dof in enumerate(DOFS):
        value, side = float(shown[i]), int(shown[i] > 0)
        if dof not in reading.dofs or not np.isfinite(value):
            continue
        is_near = abs(value) <= limits[i] / np.sqrt(3)
        number = f"{abs(value):.2f} {DISPLAY_UNITS[i]}"
        what, where = WORDS[i][side], arrows[i][side] * _how_many(abs(value), limits[i])
        if reading.axes == "poses":
            what, where, number = dof, "", f"{value:+.2f} {DISPLAY_UNITS[i]}"
        spread = f"{'+-' if out.options.ascii_only else '±'} {deviations[i]:.2f}"
        cells = (where, what, number, spread if np.isfinite(deviations[i]) else "")
        table.add_row(*cells, style="green" if is_near else "")
    lines: list[RenderableType] = [Text(reading.message, style=_STYLES[reading.status])]
    if np.isfinite(reading.estimate.similarity):
        least = _least(reading, settings)
        similarity = f"similarity {reading.estimate.similarity:.2f}, at least {least:.2f} needed"
        lines.append(Text(similarity))
    return Group(table, *lines)


def _least(reading: Aim, settings: Any) -> float:
    least = settings.least_similarity
    return float(reading.estimate.least_similarity if least is None else least)


def _how_many(value: float, limit: float) -> int:
    """Arrows for a correction: one near the tolerance, two up to ten times, three beyond."""
    return 1 + (value > 2 * limit) + (value > 10 * limit)
