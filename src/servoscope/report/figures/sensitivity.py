"""How errors grow with everything that may change: a panel for each disturbance."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from servoscope.report.figures.panels import INK, SMALL, Layout, dress, new_axes

DOF_STYLES: dict[str, dict[str, Any]] = {
    "tx": {"color": "#12314f", "marker": "o"},
    "ty": {"color": "#12314f", "marker": "s"},
    "tz": {"color": "#12314f", "marker": "^"},
    "rx": {"color": "#c4743f", "marker": "o"},
    "ry": {"color": "#c4743f", "marker": "s"},
    "rz": {"color": "#c4743f", "marker": "^"},
}
"""Translations are dark and rotations pale; the axis is told by the marker."""

LEAST, MOST = 0.003, 10.0
"""Of the errors that are shown, in shares of the range."""


def plot_growth(
    growths: Mapping[str, Mapping[str, Any]],
    ranges: Mapping[str, Mapping[str, Any]],
    *,
    title: str = "",
    ax: Axes | None = None,
) -> Axes:
    """Error of each dof in shares of its range against the strength of one disturbance.

    Parameters
    ----------
    growths : dict
        By dof, what `ErrorGrowth.to_dict` gives.
    ranges : dict
        By dof, ``{"value", "unit"}``.
    title : str
    """
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
