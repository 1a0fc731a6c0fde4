"""Pictures of one size side by side in one set of axes, which draws far faster than one each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from servoscope.report.figures.panels import INK, MUTED, NORMAL, new_axes

GAP, TITLE = 0.1, 0.2
"""Space between columns and above each picture, as shares of a picture's width."""

FRAME: dict[str, Any] = {"color": MUTED, "linewidth": 0.5, "scalex": False, "scaley": False}


def plot_mosaic(
    pictures: Sequence[NDArray[Any]] | NDArray[Any],
    titles: Sequence[str],
    *,
    n_columns: int = 6,
    ax: Axes | None = None,
    **mapping: Any,
) -> Axes:
    """Pictures row by row, each with its title above.

    Parameters
    ----------
    pictures : sequence of ndarray of shape (height, width)
    titles : sequence of str
    n_columns : int
    **mapping
        How values become colours, as `matplotlib.axes.Axes.imshow` takes it.
    """
    ax = new_axes() if ax is None else ax
    height, width = pictures[0].shape
    corners = list(mosaic_corners((height, width), len(pictures), n_columns))
    for (x, y), picture, title in zip(corners, pictures, titles, strict=True):
        left, right, top, bottom = x - 0.5, x + width - 0.5, y - 0.5, y + height - 0.5
        ax.imshow(picture, extent=(left, right, bottom, top), **mapping)
        ax.plot([left, right, right, left, left], [top, top, bottom, bottom, top], **FRAME)
        place: dict[str, Any] = {"ha": "center", "va": "bottom", "fontsize": NORMAL, "color": INK}
        ax.text(x + width / 2, top - 0.03 * width, title, **place)
    right, bottom = np.max(corners, axis=0) + np.array([width, height])
    margin = 0.02 * width
    ax.set(
        xlim=(-margin - 0.5, right + margin - 0.5),
        ylim=(bottom + margin - 0.5, -TITLE * width - 0.5),
        aspect="equal",
    )
    ax.axis("off")
    return ax


def mosaic_corners(
    shape: tuple[int, int], n_pictures: int, n_columns: int
) -> Iterator[tuple[float, float]]:
    """Where pixel (0, 0) of each picture stands, x before y, [px]."""
    height, width = shape
    for i in range(n_pictures):
        row, column = divmod(i, n_columns)
        yield column * (1 + GAP) * width, row * (height + TITLE * width)


def new_mosaic(
    shape: tuple[int, int], n_pictures: int, *, n_columns: int = 6, width: float = 1.18
) -> tuple[Figure, Axes]:
    """A figure in which each picture is `width` inches wide, and axes that fill it."""
    n_columns = min(n_columns, n_pictures)
    n_rows = -(-n_pictures // n_columns)
    total_x = width * (n_columns * (1 + GAP) - GAP + 0.04)
    total_y = width * (n_rows * (shape[0] / shape[1] + TITLE) + 0.02)
    figure = Figure(figsize=(total_x, total_y), facecolor="white")
    return figure, figure.add_axes((0, 0, 1, 1))
