"""A rehearsal in pictures: how many arrive, where those start that do not, and what is seen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from servoscope.report.figures.mosaic import new_mosaic, plot_mosaic
from servoscope.report.figures.panels import ACCENT, INK, MUTED, SMALL, Layout, dress, new_axes

Results = Mapping[str, Mapping[str, Any]]
"""By condition, what `Rehearsal.run` returns."""


def plot_success(results: Results, *, enough: float, ax: Axes | None = None) -> Axes:
    """Share of the starts that arrive under each condition, with its 95 % interval.

    Parameters
    ----------
    results : dict
    enough : float
        The share that is marked by a line.
    """
    ax = new_axes() if ax is None else ax
    dress(ax, xlabel="starts that arrive [%]")
    for row, numbers in enumerate(results.values()):
        share = 100 * numbers["success"] / numbers["trials"]
        low, high = (100 * bound for bound in numbers["success_interval"])
        is_enough = share >= 100 * enough
        color = INK if is_enough else ACCENT
        ax.plot([low, high], [row, row], color=color, linewidth=1.0)
        ax.plot(share, row, "o" if is_enough else "s", color=color, markersize=5)
    ax.axvline(100 * enough, color=MUTED, linewidth=0.6, linestyle=":")
    ax.set(xlim=(-2, 103), ylim=(len(results) - 0.5, -0.5))
    ax.set_yticks(range(len(results)), list(results))
    return ax


def draw_success(results: Results, enough: float) -> Figure:
    """The chart of `plot_success`."""
    layout = Layout(1, 4.6, 0.24 * len(results) + 0.1, left=1.0, bottom=0.45, top=0.1, right=0.15)
    figure, (ax,) = layout.make(1)
    plot_success(results, enough=enough, ax=ax)
    return figure


def plot_starts(
    starts: Sequence[Mapping[str, Any]], *, title: str = "", ax: Axes | None = None
) -> Axes:
    """Where in the range the starts lie, and which of them do not arrive.

    Parameters
    ----------
    starts : sequence of dict
        Each with ``shares`` of the range, (6,), and ``succeeded``.
    title : str
    """
    ax = new_axes() if ax is None else ax
    dress(ax, title=title)
    shares = np.abs([start["shares"] for start in starts])
    arrived = np.array([start["succeeded"] for start in starts], dtype=bool)
    x, y = (np.sqrt((part**2).mean(axis=1)) for part in (shares[:, :3], shares[:, 3:]))
    ax.plot(x[arrived], y[arrived], "o", color=MUTED, markersize=3.5, fillstyle="none")
    ax.plot(x[~arrived], y[~arrived], "s", color=ACCENT, markersize=4)
    most = max(1.0, float(shares.max()))
    ax.set(xlim=(0, most), ylim=(0, most), xticks=(0, 0.5, 1), yticks=(0, 0.5, 1))
    return ax


def draw_starts(results: Results) -> Figure:
    """A panel for each condition, five in a row."""
    layout = Layout(5, 1.3, 1.3, gap_x=0.3, gap_y=0.45, left=0.55, right=0.15, bottom=0.45, top=0.3)
    figure, axes = layout.make(len(results))
    for ax, (name, numbers) in zip(axes, results.items(), strict=True):
        plot_starts(numbers["starts"], title=name, ax=ax)
    for ax in axes[:: layout.n_columns]:
        ax.set_ylabel("rotation [of range]", fontsize=SMALL, color=INK, labelpad=2)
    for ax in axes[-layout.n_columns :]:
        ax.set_xlabel("translation [of range]", fontsize=SMALL, color=INK, labelpad=2)
    return figure


def draw_examples(images: Mapping[str, NDArray[np.uint8]]) -> Figure:
    """The images row by row, each with its name above."""
    pictures = list(images.values())
    figure, ax = new_mosaic(pictures[0].shape, len(pictures), n_columns=4, width=1.8)
    plot_mosaic(pictures, list(images), n_columns=4, ax=ax, cmap="gray", vmin=0, vmax=255)
    return figure
