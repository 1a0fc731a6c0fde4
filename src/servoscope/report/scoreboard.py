"""The scoreboard as a page, a figure and a table for documents."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from servoscope.files import write_text
from servoscope.report.facts import describe_figure
from servoscope.report.figures.captions import Caption
from servoscope.report.figures.rendering import FigureOrder, draw_figures
from servoscope.report.figures.trajectories import draw_trajectories
from servoscope.report.html import render_page
from servoscope.scoreboard.table import (
    COLUMNS,
    LEGEND,
    TITLES,
    as_markdown,
    table_rows,
    target_text,
)
from servoscope.scoreboard.targets import Trials

SHOWN = ("range_1.0", "gain_0.8", "covered_10", "noise_10")
"""The conditions whose trajectories are drawn."""

CAPTION = Caption(
    "Trajectories",
    "True position error from image to image: thick the median of all starts, thin some of the "
    "starts. The level line is 1 mm.",
    "Charts of position error against images taken, one for each scene and condition, with a line "
    "for each method.",
)


def write_scoreboard(
    folder: Path, scoreboard: dict[str, Any], trials: Mapping[str, Trials]
) -> Path:
    """Write ``scoreboard.html``, ``scoreboard.md`` and ``figures/trajectories.png``.

    Parameters
    ----------
    folder : Path
    scoreboard : dict
        As in ``scoreboard.json``.
    trials : dict
        The trials by scene, condition and method.

    Returns
    -------
    Path
        The page: one file that needs neither a network nor the rest of the folder.
    """
    draw = partial(draw_trajectories, _panels(trials))
    (figure,) = draw_figures(
        [FigureOrder("trajectories", CAPTION, draw)], folder / "figures", n_jobs=1
    )
    write_text(folder / "scoreboard.md", as_markdown(scoreboard))
    facts = {
        "scoreboard": scoreboard,
        "columns": COLUMNS,
        "legend": LEGEND,
        "scenes": [(TITLES[s], table_rows(scoreboard, s)) for s in scoreboard["results"]],
        "targets": [(target, target_text(target)) for target in scoreboard["targets"]],
        "figure": describe_figure(figure),
    }
    path = folder / "scoreboard.html"
    write_text(path, render_page(facts, "scoreboard.html"))
    return path


def _panels(trials: Mapping[str, Trials]) -> dict[str, dict[str, list[list[float]]]]:
    """The paths in mm that are drawn, by title of the panel."""
    return {
        f"{TITLES[scene].lower()}, {condition}": {
            method: [trial.path_mm for trial in runs] for method, runs in by_method.items()
        }
        for scene, conditions in trials.items()
        for condition, by_method in conditions.items()
        if condition in SHOWN or len(conditions) <= len(SHOWN)
    }
