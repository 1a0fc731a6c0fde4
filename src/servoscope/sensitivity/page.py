"""The sensitivity analysis as tables and as figures."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from servoscope.report.figure import (
    DOF_STYLES,
    INK,
    SMALL,
    Caption,
    FigureOrder,
    Layout,
    draw_figures,
    dress,
    new_axes,
)
from servoscope.report.table import Table, write_tables

Sensitivity = Mapping[str, Mapping[str, Mapping[str, Any]]]
"""By disturbance and dof, what `ErrorGrowth.to_dict` gives."""

TITLES = {
    "doubles_at": "strength at which the error has doubled",
    "parts_at": "strength at which first order is 20 % off the simulation",
}
"""What a table can show."""

CAPTION = Caption(
    "Sensitivity",
    "RMS error of each degree of freedom against the strength of each disturbance: solid in images "
    "taken anew, dashed to first order.",
    "Charts of RMS errors against strength, one for each disturbance, with a solid and a dashed "
    "line for each degree of freedom.",
)

LEAST, MOST = 0.003, 10.0
"""Of the errors that are shown, in shares of the range."""


def plot_growth(
    growths: Mapping[str, Mapping[str, Any]],
    ranges: Mapping[str, Mapping[str, Any]],
    *,
    title: str = "",
    ax: Axes | None = None,
) -> Axes:
    """Error of each dof in shares of its range against the strength of one disturbance."""
    ax = new_axes() if ax is None else ax
    unit = next(iter(growths.values()))["unit"]
    dress(ax, title=title, xlabel="" if unit == "1" else f"[{unit}]")
    for dof, growth in growths.items():
        scale, style = ranges[dof]["value"], DOF_STYLES[dof]
        strengths = np.array([0.0, *growth["strengths"]])
        order = np.argsort(strengths)
        simulated, predicted = (
            np.array([growth["clean_rms"], *growth[key]])[order] / scale
            for key in ("simulated_rms", "predicted_rms")
        )
        ax.plot(strengths[order], simulated, linewidth=0.9, markersize=2.4, label=dof, **style)
        ax.plot(strengths[order], predicted, "--", linewidth=0.7, color=style["color"])
    _scale(ax, strengths.tolist())
    return ax


def draw_sensitivity(
    sensitivity: Mapping[str, Mapping[str, Mapping[str, Any]]],
    ranges: Mapping[str, Mapping[str, Any]],
) -> Figure:
    """A panel for each disturbance, four in a row, with one legend."""
    layout = Layout(4, 1.75, 1.3, gap_x=0.45, gap_y=0.66, left=0.55, bottom=0.45, top=0.6)
    figure, axes = layout.make(len(sensitivity))
    for ax, (name, growths) in zip(axes, sensitivity.items(), strict=True):
        plot_growth(growths, ranges, title=name.replace("_", " "), ax=ax)
    for ax in axes[:: layout.n_columns]:
        ax.set_ylabel("RMS error [of range]", fontsize=SMALL, color=INK, labelpad=2)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="upper left", ncols=6, fontsize=SMALL + 1, frameon=False)
    return figure


def _scale(ax: Axes, strengths: list[float]) -> None:
    """Errors by their logarithm, strengths too but for those about 0."""
    sizes = sorted({abs(s) for s in strengths})
    ax.set_yscale("log")
    low, high = ax.get_ylim()
    ax.set_ylim(max(low, LEAST), min(high, MOST))
    ax.set_xscale("symlog", linthresh=sizes[1], linscale=0.6)
    ends = {0.0, sizes[1], sizes[-1]}
    shown = [s for s in strengths if abs(s) in ends]
    ax.xaxis.set_major_locator(FixedLocator(shown))
    ax.xaxis.set_minor_locator(NullLocator())
    ax.xaxis.set_major_formatter(FuncFormatter(lambda s, _: f"{s:g}"))
    ax.yaxis.set_major_locator(FixedLocator([0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0]))
    ax.yaxis.set_major_formatter(FuncFormatter(lambda e, _: f"{e:g}"))
    ax.yaxis.set_minor_locator(NullLocator())


def sensitivity_table(name: str, sensitivity: Sensitivity, key: str) -> Table:
    """A row for each disturbance; ``> s`` where it is beyond the largest strength s tried.

    With the key ``"doubles_at"`` the undisturbed errors stand above.
    """
    by_dof = next(iter(sensitivity.values()))
    clean = ("none (RMS error)", "mm, deg", *(f"{g['clean_rms']:.3g}" for g in by_dof.values()))
    rows = [
        (name, next(iter(growths.values()))["unit"], *(_cell(g, key) for g in growths.values()))
        for name, growths in sensitivity.items()
    ]
    return Table(
        ("disturbance", "unit", *by_dof),
        [clean, *rows] if key == "doubles_at" else rows,
        f"{name}: {TITLES[key]}",
        align="llr",
    )


def write_sensitivity(folder: Path, results: dict[str, Any], *, n_jobs: int = -1) -> list[Path]:
    """Write ``sensitivity.md`` and ``figures/sensitivity_{features}.png``; returns the figures."""
    of_features = {name: one["sensitivity"] for name, one in results["features"].items()}
    tables = [
        sensitivity_table(name, of, key) for name, of in of_features.items() for key in TITLES
    ]
    write_tables(folder / "sensitivity.md", tables)
    orders = [
        FigureOrder(
            f"sensitivity_{name}", CAPTION, partial(draw_sensitivity, of, results["ranges"])
        )
        for name, of in of_features.items()
    ]
    figures = draw_figures(orders, folder / "figures", n_jobs=n_jobs)
    return [folder / "figures" / f"{figure.name}.png" for figure in figures]


def _cell(growth: Mapping[str, Any], key: str) -> str:
    if growth[key] is None:
        return f"> {max(map(abs, growth['strengths'])):g}"
    return f"{float(f'{growth[key]:.2g}'):g}"
