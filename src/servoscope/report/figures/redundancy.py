"""How much of the redundancy at each step of the selection is bias."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from servoscope.poses import DOFS
from servoscope.report.figures.panels import INK, MUTED, SMALL, Layout, dress, new_axes
from servoscope.report.names import DOF_LABELS

Steps = list[dict[str, float]]

CHARTS = Layout(3, 2.7, 1.5, gap_x=0.6, gap_y=0.62, left=0.5, right=0.08, bottom=0.4, top=0.25)


def plot_redundancy(steps: Steps, *, dof: str, ax: Axes | None = None) -> Axes:
    """Redundancy of the feature selected at each step, its bias, and that of unrelated features.

    Parameters
    ----------
    steps : list of dict
        ``redundancy``, ``bias`` and ``unrelated`` of each step, [bits].
    dof : str
    """
    ax = new_axes() if ax is None else ax
    number = np.arange(1, len(steps) + 1)
    redundancy, bias, unrelated = (
        [step[part] for step in steps] for part in ("redundancy", "bias", "unrelated")
    )
    ax.plot(number, redundancy, "o-", color=INK, markersize=2.6, linewidth=1, label="redundancy")
    ax.fill_between(number, bias, color=MUTED, alpha=0.25, linewidth=0)
    ax.plot(number, bias, "--", color=MUTED, linewidth=1, label="bias")
    ax.plot(number, unrelated, ":", color=INK, linewidth=1, label="unrelated features")
    ax.set(xlim=(1, max(len(steps), 2)), ylim=(0, None))
    return dress(ax, title=DOF_LABELS[dof], xlabel="step", ylabel="[bits]")


def draw_redundancies(by_dof: dict[str, Steps]) -> Figure:
    """Redundancy and bias of each degree of freedom."""
    figure, panels = CHARTS.make(len(DOFS))
    for dof, ax in zip(DOFS, panels, strict=True):
        plot_redundancy(by_dof[dof], dof=dof, ax=ax)
    panels[0].legend(fontsize=SMALL, frameon=False, loc="upper left")
    return figure
