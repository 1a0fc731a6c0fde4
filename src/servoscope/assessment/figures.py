"""What an assessment found, as pictures."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullFormatter

from servoscope.assessment.verdict import arrives
from servoscope.poses import DISPLAY_UNITS, DOF_LABELS
from servoscope.report.figure import (
    ACCENT,
    DOF_STYLES,
    INK,
    MUTED,
    SMALL,
    Caption,
    FigureOrder,
    Layout,
    dress,
    new_axes,
)

Rows = Mapping[str, Mapping[str, Any]]

CAPTIONS = {
    "reach": Caption(
        "What each degree of freedom reaches",
        "RMS errors, on logarithmic scales: left of the tolerance is accurate enough. The bar is "
        "the 90 % interval of one look.",
        "Two charts, of translations in mm and of rotations in degrees, with a row for each degree "
        "of freedom: its tolerance, one look, the end of the loop and what the view allows. The "
        "table has the numbers.",
    ),
    "budgets": Caption(
        "Where the error comes from",
        "Shares of the squared error of each degree of freedom. Too few images: what ten times as "
        "many would take away; weak features: what is left.",
        "Stacked bars, one for each degree of freedom, of shares of the squared error.",
    ),
    "behind": Caption(
        "More images, and how good forecasts are",
        "Left: forecast errors with 1, 2, 5 and 10 times the images. Right: forecast against "
        "reached errors, one mark for each family and degree of freedom; dotted lines are at 0.75 "
        "and 1.33. Errors are shares of the error of predicting the mean; translations are "
        "dark.",
        "A chart of errors against numbers of images, and one of reached against forecast errors.",
    ),
}

REACH_STYLES: dict[str, dict[str, Any]] = {
    "tolerance": {"color": ACCENT, "marker": "|", "markersize": 17, "markeredgewidth": 3},
    "one look": {"color": INK, "marker": "o", "markersize": 6},
    "loop": {"color": INK, "marker": "D", "markersize": 6, "fillstyle": "none"},
    "loop, not all arrive": {"color": INK, "marker": "x", "markersize": 6},
    "view allows": {"color": MUTED, "marker": "|", "markersize": 9, "markeredgewidth": 1.5},
}
"""Each has its own marker, so that colour is never needed to tell them apart."""

SHARES = {
    "noise": ("pixel noise", "#1c2733", ""),
    "pose_labels": ("pose labels", "#6b7782", "...."),
    "too_few_images": ("too few images", "#b3501e", "////"),
    "regressor": ("regressor", "#e3b98a", "xxxx"),
    "weak_features": ("weak features", "#f1efea", ""),
}
"""Each share has its own hatch, so that colour is never needed to tell them apart."""


def moving(rows: Rows) -> list[str]:
    """The dofs that have a forecast."""
    return [dof for dof, row in rows.items() if row["forecast_rms"] is not None]


def plot_reach(rows: Rows, *, ax: Axes | None = None) -> Axes:
    """What one look and the loop reach, what is asked for and what the view allows, by dof.

    Parameters
    ----------
    rows : dict
        The decision by dof, of dofs with one unit.
    """
    ax = new_axes() if ax is None else ax
    for place, row in enumerate(rows.values()):
        look, loop = row["one_look"], row["loop"]
        name_of_loop = "loop" if arrives(loop) else "loop, not all arrive"
        ax.plot(look["interval"], [place, place], color=INK, linewidth=5, alpha=0.25)
        for name, value in (
            ("tolerance", row["tolerance"]),
            ("one look", look["rms"]),
            (name_of_loop, None if loop is None else loop["end_rms"]),
            ("view allows", row["view_limit"]),
        ):
            if value:
                ax.plot(value, place, label=name, **REACH_STYLES[name])
    ax.set_xscale("log")
    (unit,) = {row["unit"] for row in rows.values()}
    dress(ax, xlabel=f"RMS error [{unit}]", is_log=True)
    ax.xaxis.set_major_formatter("{x:g}")
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.set_yticks(range(len(rows)), [DOF_LABELS[dof] for dof in rows])
    ax.set_ylim(len(rows) - 0.5, -0.5)
    ax.grid(axis="x", color="#d5d9dd", linewidth=0.6)
    ax.set_axisbelow(True)
    return ax


def plot_budgets(rows: Rows, *, ax: Axes | None = None) -> Axes:
    """Shares of each dof's squared error, stacked."""
    ax = new_axes() if ax is None else ax
    dofs = moving(rows)
    places = np.arange(len(dofs))[::-1]
    left = np.zeros(len(dofs))
    for name, (label, colour, hatch) in SHARES.items():
        widths = np.array([100 * rows[dof]["budget"][name] for dof in dofs])
        ax.barh(
            places,
            widths,
            left=left,
            height=0.7,
            label=label,
            facecolor=colour,
            hatch=hatch,
            edgecolor=INK,
            linewidth=0.5,
        )
        left += widths
    dress(ax, xlabel="share of the squared error [%]")
    ax.set_yticks(places, [DOF_LABELS[dof] for dof in dofs])
    ax.set_xlim(0, 100)
    ax.legend(**LEGEND)
    return ax


def plot_learning_curves(rows: Rows, *, ax: Axes | None = None) -> Axes:
    """Error of each dof against the number of images, from those there are on."""
    ax = new_axes() if ax is None else ax
    for dof in moving(rows):
        curve, unit = rows[dof]["learning_curve"], rows[dof]["baseline_rms"] or 1.0
        errors = np.array(curve["rms"]) / unit
        style: dict[str, Any] = {**DOF_STYLES[dof], "linewidth": 1.0, "markersize": 4}
        ax.plot(curve["n_images"], errors, label=dof, **style)
    ax.set(xscale="log", yscale="log")
    dress(ax, is_log=True, xlabel="images to learn from", ylabel="RMS error [of that of the mean]")
    ax.minorticks_off()
    ax.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    counts = sorted({n for dof in moving(rows) for n in rows[dof]["learning_curve"]["n_images"]})
    ax.set_xticks(counts, [f"{n}" for n in counts])
    ax.legend(**LEGEND)
    return ax


def plot_validation(families: Mapping[str, Any], rows: Rows, *, ax: Axes | None = None) -> Axes:
    """Forecast against reached error, one mark for each candidate and dof.

    Parameters
    ----------
    families : dict
        What each candidate was forecast to reach and reached.
    rows : dict
        The decision by dof; errors are shares of the error of predicting the mean.
    """
    ax = new_axes() if ax is None else ax
    for dof in moving(rows):
        unit = rows[dof]["baseline_rms"] or 1.0
        pairs = np.array(
            [
                (family["dofs"][dof]["forecast_rms"], family["dofs"][dof]["reached_rms"])
                for family in families.values()
                if family["dofs"][dof]["reached_rms"] is not None
            ]
        ).reshape(-1, 2)
        ax.plot(
            *(pairs / unit).T,
            linestyle="",
            markersize=4,
            label=dof,
            alpha=0.8,
            **DOF_STYLES[dof],
        )
    ends = np.array([0.5 * min(ax.get_xlim()[0], ax.get_ylim()[0]), 2.0])
    ends[0] = max(ends[0], 1e-3)
    for factor, style in ((1.0, "-"), (0.75, ":"), (1.33, ":")):
        ax.plot(ends, ends / factor, color=MUTED, linewidth=0.8, linestyle=style, zorder=0)
    ax.set(xscale="log", yscale="log", xlim=ends, ylim=ends)
    dress(
        ax,
        is_log=True,
        xlabel="forecast [of the mean's error]",
        ylabel="reached [of the mean's error]",
    )
    ax.xaxis.set_major_formatter("{x:g}")
    ax.legend(**LEGEND)
    return ax


LEGEND: dict[str, Any] = {
    "fontsize": SMALL,
    "ncols": 6,
    "frameon": False,
    "loc": "lower left",
    "bbox_to_anchor": (0, 1.0),
    "columnspacing": 1.2,
    "handletextpad": 0.4,
}


def draw_reach(rows: Rows) -> Figure:
    """What all moving dofs reach, a chart for each unit, with one legend."""
    shown = [
        {dof: rows[dof] for dof in moving(rows) if rows[dof]["unit"] == unit}
        for unit in DISPLAY_UNITS[::3]
    ]
    shown = [panel for panel in shown if panel]
    layout = Layout(1, 3.9, 1.25, gap_y=0.55, left=0.4, right=0.2, bottom=0.45, top=0.35)
    figure, axes = layout.make(len(shown))
    for ax, panel in zip(axes, shown, strict=True):
        plot_reach(panel, ax=ax)
    handles = [Line2D([], [], linestyle="", label=name, **style) for name, style in _drawn(axes)]
    figure.legend(handles=handles, **LEGEND | {"loc": "upper left", "bbox_to_anchor": (0, 1)})
    return figure


def _drawn(axes: list[Axes]) -> Iterator[tuple[str, dict[str, Any]]]:
    """What the legend has to explain."""
    labels = {label for ax in axes for label in ax.get_legend_handles_labels()[1]}
    for name, style in REACH_STYLES.items():
        if name in labels:
            yield name, {**style, "markersize": min(style["markersize"], 10)}


def draw_budgets(rows: Rows) -> Figure:
    """The error budgets of all dofs."""
    figure = Figure(figsize=(9.6, 2.6), facecolor="white")
    plot_budgets(rows, ax=figure.add_axes((0.05, 0.16, 0.93, 0.72)))
    return figure


def draw_behind(families: Mapping[str, Any], rows: Rows) -> Figure:
    """Learning curves, and forecast against reached errors."""
    figure = Figure(figsize=(9.6, 3.8), facecolor="white")
    plot_learning_curves(rows, ax=figure.add_axes((0.07, 0.12, 0.50, 0.78)))
    plot_validation(families, rows, ax=figure.add_axes((0.67, 0.12, 0.31, 0.78)))
    return figure


def list_figures(assessed: Mapping[str, Any]) -> list[FigureOrder]:
    """The figures of an assessment; none where nothing has a forecast."""
    rows = assessed["dofs"]
    if not moving(rows):
        return []
    draw: dict[str, Callable[[], Figure]] = {
        "reach": partial(draw_reach, rows),
        "budgets": partial(draw_budgets, rows),
        "behind": partial(draw_behind, assessed["families"], rows),
    }
    return [FigureOrder(kind, CAPTIONS[kind], drawing) for kind, drawing in draw.items()]
