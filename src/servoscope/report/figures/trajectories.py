"""How the error falls from image to image, for every method of the scoreboard."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from servoscope.report.figures.panels import ACCENT, INK, MUTED, SMALL, Layout, dress, new_axes

Paths = Mapping[str, Sequence[Sequence[float]]]
"""Errors of each start of a method, [mm], at every look."""

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
    """Position error against the images taken, of every method.

    Parameters
    ----------
    paths : dict of sequences of sequences of float
        By method and start, [mm]; a run that has ended stays where it is.
    title : str
    """
    ax = new_axes() if ax is None else ax
    dress(ax, title=title, xlabel="images taken, 1 at the start", ylabel="position error [mm]")
    ax.set(xscale="log", yscale="log")
    for method, runs in paths.items():
        style = METHOD_STYLES[method]
        for run in runs[:MOST_STARTS]:
            looks = np.arange(1, len(run) + 1)
            ax.plot(looks, _shown(run), color=style["color"], linewidth=0.4, alpha=0.3)
        median = _median_path(runs)
        looks = np.arange(1, len(median) + 1)
        every = sorted({int(k) for k in np.geomspace(1, len(median), 6)})
        marks = [k - 1 for k in every]
        ax.plot(looks, median, linewidth=1.6, markersize=4, markevery=marks, label=method, **style)
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
