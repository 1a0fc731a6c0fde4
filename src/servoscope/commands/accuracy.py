"""How accurate a model is, as ``train`` and ``info`` print it."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping
from typing import Any

from rich.table import Table

from servoscope.commands.output import console
from servoscope.poses import DISPLAY_UNITS, DOFS
from servoscope.wording import plain_number

NONE = "–"
"""What is shown of a number that there is not."""

_HEADINGS = (
    ("features:", "forecast"),
    ("features:", "held out"),
    ("one look:", "held out"),
    ("the loop", "ends at"),
    ("the view", "allows"),
)
_LARGEST = 1e6
_WIDTH = 80

_NEEDED = {
    "depth": "depth is not known, so translations are not read, only rotations; move along all "
    "axes",
    "mount_translation": "where the camera sits is not known; turn about all axes",
    "mount_rotation": "how the camera is turned is not known; move along and about all axes",
    "focal_length": "focal length and depth are not separable; move along the optical axis too",
}


def has_table(accuracy: Any) -> bool:
    """Whether the accuracy of a model's header, which may be anybody's, can be shown as a table."""
    held_out = _held_out(accuracy)[1]
    return any(_is_number(held_out.get(dof)) for dof in DOFS)


def print_accuracy(
    accuracy: Mapping[str, Any], *, limit: Mapping[str, float] | None = None
) -> None:
    """Print one table within 80 columns: what each dof was forecast to reach, and reaches.

    A column of which nothing is known is left out.

    Parameters
    ----------
    accuracy : mapping
        Of a model; what cannot be read of it is shown as a dash.
    limit : mapping of str to float, optional
        Smallest standard deviation of one look at the reference by dof, in mm and degrees; of a
        keyframe.
    """
    statistic, held_out = _held_out(accuracy)
    assessment = _within(accuracy, "assessment")
    rows, forecast = _within(assessment, "dofs"), _within(accuracy, "forecast")
    is_rehearsed, cells = False, []
    for dof, unit in zip(DOFS, DISPLAY_UNITS, strict=True):
        if dof not in held_out:
            continue
        row = _within(rows, dof)
        end = None if limit is None else _within(row, "loop").get("end_rms")
        is_rehearsed |= _cell(end, unit) != NONE
        values = (
            row.get("forecast_rms", forecast.get(dof)),
            row.get("reached_rms"),
            held_out[dof],
            end,
        )
        cells.append([dof, *(_cell(x, unit) for x in (*values, (limit or {}).get(dof)))])
    table = Table(title="Error of each dof about the pivot", title_justify="left", padding=(0, 1))
    headings = ("dof", *(f"{what}\n{of}" for what, of in _HEADINGS))
    known = [i for i in range(len(headings)) if any(shown[i] != NONE for shown in cells)]
    for i in known:
        table.add_column(headings[i], justify="right", no_wrap=True)
    for shown in cells:
        table.add_row(*(shown[i] for i in known))
    out = console()
    out.print(table)
    for line in _notes(accuracy, statistic, is_keyframe=limit is not None):
        out.print(textwrap.fill(line, _WIDTH))
    if not rows and not forecast:
        out.print("forecast: servoscope assess DATA --out RUN, then train DATA --assessment RUN")
    if limit is not None and not is_rehearsed:
        out.print("in the loop: servoscope rehearse MODEL")


def observability(observable: Mapping[str, bool]) -> str:
    """What the images inform of lens, mount and depth, in one line.

    Examples
    --------
    >>> observability({"depth": True, "focal_length": True})
    'observable: depth, focal length'
    """
    missing = [name for name, seen in observable.items() if not seen]
    if missing:
        unknown = [_NEEDED.get(name, name.replace("_", " ")) for name in missing]
        return f"not observable: {'; '.join(unknown)}"
    return f"observable: {', '.join(name.replace('_', ' ') for name in observable)}"


def _held_out(accuracy: Any) -> tuple[str, Mapping[str, Any]]:
    """The errors of images held out by dof, and what they are; nothing where there are none."""
    for name, words in (("rms", "RMS"), ("median", "median")):
        values = _within(accuracy, name)
        if values:  # models had medians before they had RMS errors
            return words, values
    return "", {}


def _notes(accuracy: Mapping[str, Any], statistic: str, *, is_keyframe: bool) -> Iterator[str]:
    """What the columns of the table are of."""
    held_out = _within(accuracy, "held_out")
    images, groups = held_out.get("images"), held_out.get("groups")
    share: Any = held_out.get("share_right")
    said = f"one look, held out: {statistic}"
    if isinstance(images, int):
        said += f" of {images} images"
        if isinstance(groups, int) and groups < images:
            said += f" in {groups} independent groups"
        if _is_number(share) and share < 1:
            said += f", of the {round(share * images)} read within a quarter of the range"
    yield said
    loop = _within(_within(accuracy, "assessment"), "loop")
    if is_keyframe and _is_number(loop.get("success")) and isinstance(loop.get("starts"), int):
        arrived = round(loop["success"] * loop["starts"])
        said = f"in the loop: {arrived} of {loop['starts']} rehearsed starts arrive"
        mm, deg = _cell(loop.get("end_mm"), "mm"), _cell(loop.get("end_deg"), "deg")
        yield said if NONE in (mm, deg) else f"{said}; camera {mm}, {deg} away"
    if isinstance(accuracy.get("observable"), Mapping):
        yield observability(accuracy["observable"])


def _within(values: Any, name: str) -> Mapping[str, Any]:
    """A mapping in a mapping; an empty one where there is none."""
    inner = values.get(name) if isinstance(values, Mapping) else None
    return inner if isinstance(inner, Mapping) else {}


def _cell(value: Any, unit: str) -> str:
    return f"{plain_number(value)} {unit}" if _is_number(value) else NONE


def _is_number(value: Any) -> bool:
    return type(value) in (int, float) and 0 <= value < _LARGEST
