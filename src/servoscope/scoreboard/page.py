"""The scoreboard as tables, a figure and a page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from servoscope.report.figure import (
    ACCENT,
    INK,
    MUTED,
    SMALL,
    Caption,
    FigureOrder,
    Layout,
    draw_figures,
    dress,
    new_axes,
)
from servoscope.report.page import Section, bullets, pairs, write_page
from servoscope.report.table import Cell, Table, write_tables
from servoscope.scoreboard.methods import METHODS
from servoscope.scoreboard.summary import Trials

TITLES = {"cylinder_head": "Cylinder head", "textured_plane": "Textured plane"}

LEGEND = (
    "Each cell: starts that ended under 1 mm and under 0.1 deg, of how many; median moves of "
    "those; median distance and angle of all ends. (missed): a target of ours is not reached."
)

SHOWN = ("range_1.0", "gain_0.8", "covered_10", "noise_10")
"""The conditions whose trajectories are drawn."""

CAPTION = Caption(
    "Trajectories",
    "True position error from image to image: thick the median of all starts, thin some of the "
    "starts. The level line is 1 mm.",
    "Charts of position error against images taken, one for each scene and condition, with a line "
    "for each method.",
)

LEAD = (
    "Three ways to bring a camera back to its reference view, from the same starts in the same "
    "images: servoscope, the networks of Wells and Torras alone, and photometric servoing that is "
    "given the camera's calibration and the depth of every pixel."
)

Paths = Mapping[str, Sequence[Sequence[float]]]
"""Errors of each start of a method, [mm], at every image."""

METHOD_STYLES: dict[str, dict[str, Any]] = {
    "ours": {"color": INK, "linestyle": "-", "marker": "o"},
    "networks": {"color": MUTED, "linestyle": "--", "marker": "s"},
    "photometric": {"color": ACCENT, "linestyle": ":", "marker": "^"},
}
"""Each method has its own dashes and marker, so that colour is never needed to tell them apart."""

MOST_STARTS = 12
SUCCESS_MM = 1.0
LEAST_MM = 0.01


def plot_trajectories(paths: Paths, *, title: str = "", ax: Axes | None = None) -> Axes:
    """Position error, [mm], against the images taken, of every method; a run that ended stays where
    it is.
    """
    ax = new_axes() if ax is None else ax
    dress(ax, title=title, xlabel="looks, 1 at the start", ylabel="position error [mm]")
    ax.set(xscale="log", yscale="log")
    for method, runs in paths.items():
        style = METHOD_STYLES[method]
        for run in runs[:MOST_STARTS]:
            images = np.arange(1, len(run) + 1)
            ax.plot(images, _shown(run), color=style["color"], linewidth=0.4, alpha=0.3)
        median = _median_path(runs)
        images = np.arange(1, len(median) + 1)
        every = sorted({int(k) for k in np.geomspace(1, len(median), 6)})
        marks = [k - 1 for k in every]
        ax.plot(images, median, linewidth=1.6, markersize=4, markevery=marks, label=method, **style)
    ax.set(xlim=(0.85, 250), ylim=(LEAST_MM, 500))
    ax.axhline(SUCCESS_MM, color=MUTED, linewidth=0.6)
    ax.set_xticks([1, 2, 5, 10, 20, 50, 100, 200], ["1", "2", "5", "10", "20", "50", "100", "200"])
    ax.minorticks_off()
    return ax


def draw_trajectories(panels: Mapping[str, Paths]) -> Figure:
    """A panel for each title, four in a row, with one legend."""
    layout = Layout(4, 2.0, 1.75, gap_x=0.55, gap_y=0.75, left=0.55, bottom=0.5, top=0.6)
    figure, axes = layout.make(len(panels))
    for ax, (title, paths) in zip(axes, panels.items(), strict=True):
        plot_trajectories(paths, title=title, ax=ax)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper left", ncols=3, fontsize=SMALL + 1, frameon=False)
    return figure


def _median_path(runs: Sequence[Sequence[float]]) -> NDArray[np.float64]:
    longest = max(map(len, runs))
    whole = [[*run, *[run[-1]] * (longest - len(run))] for run in runs]
    return _shown(np.median(whole, axis=0))


def _shown(path: Any) -> NDArray[np.float64]:
    """A path that a logarithmic axis can show."""
    return np.maximum(path, LEAST_MM)


def scoreboard_table(scoreboard: dict[str, Any], scene: str) -> Table:
    """A row for each condition of a scene, with "(missed)" at targets not reached."""
    missed = {
        target["condition"]
        for target in scoreboard["targets"]
        if target["scene"] == scene and not target["reached"]
    }
    rows: list[list[str | Cell]] = []
    for condition, by_method in scoreboard["results"][scene].items():
        cells = [Cell(_said(by_method.get(method))) for method in METHODS]
        if condition in missed:
            at = METHODS.index("ours")
            cells[at] = Cell(cells[at].text, mark="missed", beside="(missed)")
        rows.append([condition, *cells])
    return Table(["condition", *METHODS], rows, TITLES[scene], align="l")


def write_scoreboard(
    folder: Path, scoreboard: dict[str, Any], trials: Mapping[str, Trials]
) -> Path:
    """Write ``scoreboard.html``, which needs nothing else, ``scoreboard.md`` and the figure;
    returns the page.
    """
    draw = partial(draw_trajectories, _panels(trials))
    figures = draw_figures(
        [FigureOrder("trajectories", CAPTION, draw)], folder / "figures", n_jobs=1
    )
    tables = [scoreboard_table(scoreboard, scene) for scene in scoreboard["results"]]
    targets = [target_text(target) for target in scoreboard["targets"]]
    said = "\n".join(f"- {target}" for target in targets)
    write_tables(folder / "scoreboard.md", tables, words=[LEGEND, f"Targets:\n\n{said}"])
    size = scoreboard["image_size"]
    legend = (
        f"{LEGEND} Seed {scoreboard['seed']}, {scoreboard['starts']} starts, images of {size} x "
        f"{size}."
    )
    made = {
        "Time by stage [s]": scoreboard["timings_s"].items(),
        "Machine": scoreboard["machine"].items(),
    }
    sections = [
        Section("Starts that arrive", [legend, *tables]),
        Section("Trajectories", figures),
        Section("Targets", [bullets(targets)]),
        Section("How it was made", [pairs(made)]),
    ]
    path, title = folder / "scoreboard.html", "Scoreboard of positioning"
    return write_page(path, title, sections, kind="benchmark positioning", lead=LEAD)


def target_text(target: dict[str, Any]) -> str:
    """A target and whether it was reached, in a line."""
    said = "reached" if target["reached"] else "MISSED"
    got = "none" if target["got"] is None else f"{target['got']:g}"
    scene = TITLES[target["scene"]].lower()
    what = f"{scene}, {target['condition']}, {target['what']}"
    return f"{said}: {what}: {got}, wanted {target['wanted']}"


def _said(numbers: dict[str, Any] | None) -> str:
    if numbers is None:
        return "-"
    moves = "-" if numbers["moves_median"] is None else f"{numbers['moves_median']:g}"
    return (
        f"{numbers['success']}/{numbers['trials']}, {moves} moves, "
        f"{numbers['final_mm_median']:.3g} mm, {numbers['final_deg_median']:.2g} deg"
    )


def _panels(trials: Mapping[str, Trials]) -> dict[str, Paths]:
    """The paths in mm that are drawn, by title of the panel."""
    return {
        f"{TITLES[scene].lower()}, {condition}": {
            method: [trial.path_mm for trial in runs] for method, runs in by_method.items()
        }
        for scene, conditions in trials.items()
        for condition, by_method in conditions.items()
        if condition in SHOWN or len(conditions) <= len(SHOWN)
    }
