"""RMS error against the threshold of mutual information (figure 11)."""

from __future__ import annotations

import operator
from functools import partial
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from servoscope.poses import DOFS
from servoscope.report.figures.panels import (
    ACCENT,
    INK,
    MUTED,
    SMALL,
    Layout,
    dress,
    new_axes,
)
from servoscope.report.names import DOF_LABELS, DOF_UNITS

CHARTS = Layout(3, 2.4, 1.75, gap_x=0.95, gap_y=0.62, left=0.45, right=0.5, bottom=0.4, top=0.3)


def plot_sweep(
    sweep: list[dict[str, Any]],
    *,
    dof: str,
    scale: float | None,
    decided_on_test: bool = False,
    published: float | None = None,
    ax: Axes | None = None,
) -> Axes:
    """RMS error of the subsets of a threshold sweep, with the number of features of each.

    Parameters
    ----------
    sweep : list of dict
        ``thresholds``, ``n_features``, ``rms`` and ``validation_rms`` of each subset.
    dof : str
    scale : float or None
        The range of the degree of freedom, [mm] or [deg]: the second axis.
    decided_on_test : bool
        Whether validation and test are the same images, and one curve tells both.
    published : float, optional
        Least error that was published, drawn as a line.
    """
    ax = new_axes() if ax is None else ax
    thresholds = [point["thresholds"][0] for point in sweep]
    errors = [point["rms"] for point in sweep]
    if not decided_on_test:
        decided = [point["validation_rms"] for point in sweep]
        ax.plot(thresholds, decided, "s--", color=MUTED, markersize=2.6, linewidth=0.8)
    ax.plot(thresholds, errors, "o-", color=INK, markersize=3, linewidth=1)
    if published is not None:
        ax.axhline(published, color=ACCENT, linewidth=0.8, linestyle=":")
    for threshold, error, point in zip(thresholds, errors, sweep, strict=True):
        above = decided_on_test or error >= point["validation_rms"]
        place: dict[str, Any] = {
            "xytext": (0, 4 if above else -8.5),
            "textcoords": "offset points",
            "ha": "center",
        }
        ax.annotate(str(point["n_features"]), (threshold, error), fontsize=SMALL - 1.5, **place)
    ax.set_ylim(0, 1.18 * max(*errors, published or 0.0, ax.get_ylim()[1] / 1.1, 1e-6))
    dress(ax, title=DOF_LABELS[dof], xlabel="threshold [bits]", ylabel="RMS [of range]")
    scale = scale or 1.0  # None for a dof that never moved
    functions = (partial(operator.mul, scale), partial(operator.mul, 1 / scale))
    second = ax.secondary_yaxis("right", functions=functions)
    second.set_ylabel(f"[{DOF_UNITS[dof]}]", fontsize=SMALL, color=MUTED, labelpad=1)
    second.tick_params(labelsize=SMALL - 0.5, length=2.5, width=0.6, colors=MUTED)
    second.spines["right"].set(linewidth=0.6, color=MUTED)
    return ax


def draw_sweeps(
    sweeps: dict[str, list[dict[str, Any]]],
    ranges: dict[str, dict[str, Any]],
    published: dict[str, float],
    *,
    decided_on_test: bool,
) -> Figure:
    """The threshold sweep of each degree of freedom."""
    figure, panels = CHARTS.make(len(DOFS))
    for dof, ax in zip(DOFS, panels, strict=True):
        plot_sweep(
            sweeps[dof],
            dof=dof,
            scale=ranges[dof]["value"],
            decided_on_test=decided_on_test,
            published=published.get(dof),
            ax=ax,
        )
    return figure
