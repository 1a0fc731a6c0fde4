"""The scoreboard as rows of words, for the terminal, for documents and for pages."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from servoscope.scoreboard.methods import METHODS

COLUMNS = ("condition", *METHODS)
TITLES = {"cylinder_head": "Cylinder head", "textured_plane": "Textured plane"}

LEGEND = (
    "Each cell: starts that ended under 1 mm and under 0.1 deg, of how many; median moves of "
    "those; median distance and angle of all ends."
)


@dataclass(frozen=True)
class Row:
    """A line of the table of one scene.

    Parameters
    ----------
    condition : str
    cells : tuple of str
        In the order of `METHODS`.
    missed : tuple of str
        The targets of ours that were missed, in words.
    """

    condition: str
    cells: tuple[str, ...]
    missed: tuple[str, ...]


def table_rows(scoreboard: dict[str, Any], scene: str) -> list[Row]:
    """A row for each condition of a scene."""
    return [
        Row(
            condition,
            tuple(_cell(by_method[method]) for method in METHODS),
            tuple(_missed(scoreboard, scene, condition)),
        )
        for condition, by_method in scoreboard["results"][scene].items()
    ]


def as_markdown(scoreboard: dict[str, Any]) -> str:
    """All tables, and the targets, as Markdown."""
    lines = [LEGEND, ""]
    for scene in scoreboard["results"]:
        lines += [f"**{TITLES[scene]}**", "", _line(COLUMNS), _line(["---"] * len(COLUMNS))]
        for row in table_rows(scoreboard, scene):
            ours, *others = row.cells
            marked = ours + (" (missed)" if row.missed else "")
            lines.append(_line([f"`{row.condition}`", marked, *others]))
        lines.append("")
    lines += ["Targets:", "", *(f"- {target_text(target)}" for target in scoreboard["targets"])]
    return "\n".join(lines) + "\n"


def target_text(target: dict[str, Any]) -> str:
    """A target and whether it was reached, in a line."""
    said = "reached" if target["reached"] else "MISSED"
    got = "nothing" if target["got"] is None else f"{target['got']:g}"
    scene = TITLES[target["scene"]].lower()
    return f"{said}: {scene}, {target['condition']}: {target['what']} {got}, {target['wanted']}"


def _missed(scoreboard: dict[str, Any], scene: str, condition: str) -> list[str]:
    return [
        f"{target['what']} {target['wanted']}"
        for target in scoreboard["targets"]
        if (target["scene"], target["condition"]) == (scene, condition) and not target["reached"]
    ]


def _cell(numbers: dict[str, Any]) -> str:
    moves = "-" if numbers["moves_median"] is None else f"{numbers['moves_median']:g}"
    return (
        f"{numbers['success']}/{numbers['trials']}, {moves} moves, "
        f"{numbers['final_mm_median']:.3g} mm, {numbers['final_deg_median']:.2g} deg"
    )


def _line(cells: Any) -> str:
    return f"| {' | '.join(cells)} |"
