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
from servoscope.report.page import Section, Verdict, bullets, pairs, write_page
from servoscope.report.table import NONE, Cell, Table, write_tables
from servoscope.scoreboard.methods import METHODS
from servoscope.scoreboard.summary import Trials

TITLES = {"cylinder_head": "Cylinder head", "textured_plane": "Textured plane"}

LEGEND = (
    "Each cell: starts that ended under 1 mm and under 0.1 deg, of how many; median moves of "
    "those; median distance and angle of all ends. (missed): a target of ours is not reached."
)

SHOWN = ("range_1.0", "gain_0.8", "covered_10", "noise_10")
"""The conditions whose trajectories are drawn."""

SUCCESS = Caption(
    "Starts that arrive, by condition",
    "Share of the starts that end under 1 mm and under 0.1 deg; the table has the numbers.",
    "Charts with a row for each condition, one for each scene: the share of the starts that arrive "
    "by each method.",
)

TRAJECTORIES = Caption(
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


def plot_success(
    results: Mapping[str, Mapping[str, Any]], *, title: str = "", ax: Axes | None = None
) -> Axes:
    """Share of the starts that arrive, by condition and method."""
    ax = new_axes() if ax is None else ax
    dress(ax, title=title)
    for method, style in METHOD_STYLES.items():
        rows = [(k, of[method]) for k, of in enumerate(results.values()) if of.get(method)]
        shares = [100 * numbers["success"] / numbers["trials"] for _, numbers in rows]
        look = {"linestyle": "", "markersize": 6, "fillstyle": "none", "label": method}
        ax.plot(shares, [row for row, _ in rows], **{**style, **look})
    ax.set(xlim=(-4, 104), ylim=(len(results) - 0.5, -0.5))
    ax.set_yticks(range(len(results)), list(results))
    ax.grid(axis="y", color="#d5d9dd", linewidth=0.6)
    return ax


def draw_success(scenes: Mapping[str, Mapping[str, Any]]) -> Figure:
    """A panel for each scene, one above the other, with one legend."""
    height = 0.19 * max(map(len, scenes.values())) + 0.1
    layout = Layout(1, 3.2, height, gap_y=0.5, left=1.1, right=0.15, bottom=0.45, top=0.55)
    figure, axes = layout.make(len(scenes))
    for ax, (scene, results) in zip(axes, scenes.items(), strict=True):
        plot_success(results, title=TITLES[scene], ax=ax)
    axes[-1].set_xlabel("starts that arrive [%]", fontsize=SMALL, color=INK, labelpad=2)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper left", ncols=3, fontsize=SMALL, frameon=False)
    return figure


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


def overview_table(scoreboard: dict[str, Any]) -> Table:
    """A row for each scene and method: all conditions together, and the end from the full range."""
    rows: list[list[str | Cell]] = []
    for scene, by_condition in scoreboard["results"].items():
        for method in METHODS:
            numbers = [of[method] for of in by_condition.values() if of.get(method)]
            if not numbers:
                continue
            success, trials = (sum(of[key] for of in numbers) for key in ("success", "trials"))
            full = by_condition.get("range_1.0", {}).get(method)
            ends = NONE if full is None else f"{full['final_mm_median']:.2g}"
            moves = NONE if full is None else _moves(full)
            rows.append([f"{TITLES[scene]}: {method}", f"{success}/{trials}", ends, moves])
    return Table(
        ["Scene: method", "Arrive", "End [mm]", "Moves"],
        rows,
        "",
        "Starts that end under 1 mm and under 0.1 deg, under all conditions together; and median "
        "end of all starts, and moves of those that arrive, under range_1.0.",
        align="lr",
        name="overview-table",
    )


def scoreboard_verdict(scoreboard: dict[str, Any]) -> Verdict:
    """Whether every target is reached, or which are missed."""
    targets = scoreboard["targets"]
    missed = [target for target in targets if not target["reached"]]
    step = "rehearse on the view of your own robot: servoscope rehearse MODEL."
    if not missed:
        return Verdict(f"Yes, servoscope reaches all {len(targets)} targets.", step, "yes")
    first = "; ".join(target_text(target).removeprefix("MISSED: ") for target in missed[:2])
    more = f"; and {len(missed) - 2} more" if len(missed) > 2 else ""
    said = f"No, servoscope misses {len(missed)} of {len(targets)} targets: {first}{more}."
    return Verdict(said, f"see all targets below; {step}", "no")


def write_scoreboard(
    folder: Path, scoreboard: dict[str, Any], trials: Mapping[str, Trials]
) -> Path:
    """Write ``scoreboard.html``, which needs nothing else, ``scoreboard.md`` and the figures;
    returns the page.
    """
    orders = [
        FigureOrder("success", SUCCESS, partial(draw_success, scoreboard["results"])),
        FigureOrder("trajectories", TRAJECTORIES, partial(draw_trajectories, _panels(trials))),
    ]
    success, trajectories = draw_figures(orders, folder / "figures", n_jobs=1)
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
        Section("Targets", [bullets(targets)], "targets"),
        Section("Starts that arrive", [legend, *tables]),
        Section("Trajectories", [trajectories]),
        Section("How it was made", [pairs(made)]),
    ]
    return write_page(
        folder / "scoreboard.html",
        "Scoreboard of positioning",
        scoreboard_verdict(scoreboard),
        [overview_table(scoreboard), success],
        sections,
        kind="benchmark positioning",
        lead=LEAD,
    )


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
    return (
        f"{numbers['success']}/{numbers['trials']}, {_moves(numbers)} moves, "
        f"{numbers['final_mm_median']:.3g} mm, {numbers['final_deg_median']:.2g} deg"
    )


def _moves(numbers: dict[str, Any]) -> str:
    return "-" if numbers["moves_median"] is None else f"{numbers['moves_median']:g}"


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
