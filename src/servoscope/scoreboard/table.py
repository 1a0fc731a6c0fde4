"""The scoreboard as rows of words, for the terminal, for documents and for pages."""

from __future__ import annotations

from typing import Any

from servoscope.scoreboard.methods import METHODS

COLUMNS = ("condition", *METHODS)
TITLES = {"cylinder_head": "Cylinder head", "textured_plane": "Textured plane"}

LEGEND = (
    "Each cell: starts that ended under 1 mm and under 0.1 deg, of how many; median moves of "
    "those; median distance and angle of all ends. (missed): a target of ours is not reached."
)


def table_rows(scoreboard: dict[str, Any], scene: str) -> list[tuple[str, ...]]:
    """A row of `COLUMNS` for each condition of a scene, with "(missed)" at targets not reached."""
    return [
        (
            condition,
            *(
                _cell(by_method.get(method))
                + _mark(scoreboard, scene, condition) * (method == "ours")
                for method in METHODS
            ),
        )
        for condition, by_method in scoreboard["results"][scene].items()
    ]


def as_markdown(scoreboard: dict[str, Any]) -> str:
    """All tables, and the targets, as Markdown."""
    lines = [LEGEND, ""]
    for scene in scoreboard["results"]:
        lines += [f"**{TITLES[scene]}**", "", _line(COLUMNS), _line(["---"] * len(COLUMNS))]
        for condition, *cells in table_rows(scoreboard, scene):
            lines.append(_line([f"`{condition}`", *cells]))
        lines.append("")
    lines += ["Targets:", "", *(f"- {target_text(target)}" for target in scoreboard["targets"])]
    return "\n".join(lines) + "\n"


def target_text(target: dict[str, Any]) -> str:
    """A target and whether it was reached, in a line."""
    said = "reached" if target["reached"] else "MISSED"
    got = "none" if target["got"] is None else f"{target['got']:g}"
    scene = TITLES[target["scene"]].lower()
    what = f"{scene}, {target['condition']}, {target['what']}"
    return f"{said}: {what}: {got}, wanted {target['wanted']}"


def _mark(scoreboard: dict[str, Any], scene: str, condition: str) -> str:
    missed = any(
        (target["scene"], target["condition"]) == (scene, condition) and not target["reached"]
        for target in scoreboard["targets"]
    )
    return " (missed)" if missed else ""


def _cell(numbers: dict[str, Any] | None) -> str:
    if numbers is None:
        return "-"
    moves = "-" if numbers["moves_median"] is None else f"{numbers['moves_median']:g}"
    return (
        f"{numbers['success']}/{numbers['trials']}, {moves} moves, "
        f"{numbers['final_mm_median']:.3g} mm, {numbers['final_deg_median']:.2g} deg"
    )


def _line(cells: Any) -> str:
    return f"| {' | '.join(cells)} |"
