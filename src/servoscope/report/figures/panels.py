"""Figures laid out by hand, and the look that all of them share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

INK, MUTED, ACCENT = "#1c2733", "#6b7782", "#b3501e"
SMALL, NORMAL = 7.5, 8.5

SIGNED = LinearSegmentedColormap.from_list(
    "signed", ["#08203f", "#3f6287", "#a3a5a6", "#e3b98a", "#fff6e6"], N=128
)
"""Dark blue for negative, middle grey for zero, pale orange for positive: lightness alone tells
the sign, so that a grey print reads the same."""

FAMILY_STYLES = {
    "gm": {"color": "#12314f", "marker": "o"},
    "pca": {"color": "#7f97ab", "marker": "s"},
    "pci": {"color": "#b3501e", "marker": "^"},
    "lfa35": {"color": "#9aa58c", "marker": "D"},
    "lfa85": {"color": "#55624a", "marker": "v"},
}
"""Each family has its own marker, so that colour is never needed to tell them apart."""


@dataclass(frozen=True)
class Layout:
    """Where panels of one size stand; all lengths in inches."""

    n_columns: int
    width: float
    height: float
    gap_x: float = 0.12
    gap_y: float = 0.3
    left: float = 0.05
    right: float = 0.05
    bottom: float = 0.05
    top: float = 0.25

    def make(self, n_panels: int) -> tuple[Figure, list[Axes]]:
        """A figure and its panels, row by row."""
        n_columns = min(self.n_columns, n_panels)
        n_rows = -(-n_panels // n_columns)
        total_x = self.left + n_columns * (self.width + self.gap_x) - self.gap_x + self.right
        total_y = self.bottom + n_rows * (self.height + self.gap_y) - self.gap_y + self.top
        figure = Figure(figsize=(total_x, total_y), facecolor="white")
        panels = []
        for i in range(n_panels):
            row, column = divmod(i, n_columns)
            x = self.left + column * (self.width + self.gap_x)
            y = total_y - self.top - row * (self.height + self.gap_y) - self.height
            box = (x / total_x, y / total_y, self.width / total_x, self.height / total_y)
            panels.append(figure.add_axes(box))
        return figure, panels


def new_axes() -> Axes:
    """Axes of a figure of their own."""
    return Figure(figsize=(3.2, 2.6), layout="constrained").add_subplot()


def dress(ax: Axes, *, title: str = "", xlabel: str = "", ylabel: str = "") -> Axes:
    """Give axes of a chart their words and their quiet look."""
    words: dict[str, Any] = {"fontsize": SMALL, "color": INK, "labelpad": 2}
    ax.set_xlabel(xlabel, **words)
    ax.set_ylabel(ylabel, **words)
    ax.set_title(title, fontsize=NORMAL, color=INK, pad=4)
    ax.tick_params(labelsize=SMALL - 0.5, length=2.5, width=0.6, colors=MUTED, labelcolor=INK)
    ax.locator_params(nbins=5)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        ax.spines[side].set(linewidth=0.6, color=MUTED)
    return ax
