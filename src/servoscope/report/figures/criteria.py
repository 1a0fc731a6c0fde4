"""Error against the number of features for every criterion of selection."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from servoscope.report.figures.panels import ACCENT, INK, MUTED, SMALL, Layout, dress, new_axes
from servoscope.report.names import CRITERION_NAMES, DOF_LABELS

STYLES = {
    "ideal_point": {"color": INK, "marker": "o", "linestyle": "-"},
    "ideal_point_corrected": {"color": INK, "marker": "o", "linestyle": ":"},
    "mrmr": {"color": MUTED, "marker": "s", "linestyle": "-"},
    "jmi": {"color": MUTED, "marker": "^", "linestyle": "--"},
    "cmim": {"color": MUTED, "marker": "v", "linestyle": ":"},
    "conditional": {"color": MUTED, "marker": "x", "linestyle": "-."},
    "forecast": {"color": ACCENT, "marker": "D", "linestyle": "-"},
}
"""Each criterion has its own marker and dashes, so that colour is never needed."""

CHARTS = Layout(3, 2.7, 1.9, gap_x=0.6, gap_y=0.62, left=0.5, right=0.08, bottom=1.05, top=0.25)


def plot_criteria(
    errors: Mapping[str, Sequence[float]],
    sizes: Sequence[int],
    *,
    all_candidates: float,
    title: str = "",
    ax: Axes | None = None,
) -> Axes:
    """Errors of nets with as many features as each criterion selected first.

    Parameters
    ----------
    errors : dict
        RMS errors by criterion, of range, one for each size.
    sizes : sequence of int
    all_candidates : float
        RMS error with all of them, drawn as a line.
    """
    ax = new_axes() if ax is None else ax
    places = range(len(sizes))
    for name, of_sizes in errors.items():
        style: dict[str, Any] = {"markersize": 3.2, "linewidth": 1, **STYLES[name]}
        ax.plot(places, of_sizes, label=CRITERION_NAMES[name], **style)
    ax.axhline(all_candidates, color=INK, linewidth=0.5, label="all candidates")
    ax.set_ylim(0, None)
    dress(ax, title=title, xlabel="number of features", ylabel="RMS [of range]")
    ax.set_xticks(places, [str(size) for size in sizes])
    return ax


def draw_criteria(compared: Mapping[str, Any]) -> Figure:
    """The criteria side by side, a panel a degree of freedom that moves."""
    everything = compared["all_candidates"]
    figure, panels = CHARTS.make(len(everything))
    for dof, ax in zip(everything, panels, strict=True):
        errors = {name: by_dof[dof] for name, by_dof in compared["errors"].items()}
        plot_criteria(
            errors,
            compared["sizes"],
            all_candidates=everything[dof],
            title=DOF_LABELS[dof],
            ax=ax,
        )
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(
        handles,
        labels,
        loc="lower left",
        ncols=4 if len(panels) > 1 else 2,
        fontsize=SMALL,
        frameon=False,
        handlelength=2.5,
        columnspacing=1.2,
    )
    return figure
