"""The picture of docs/conventions.md: what the worked numbers of each convention turn.

    .venv/bin/python -m benchmarks.conventions docs/images/conventions.png

Thin: the axes of the world. Thick: those that are turned. x is drawn solid, y dashed, z dotted, for
print in grey.
"""

from __future__ import annotations

import sys

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from servoscope.formats import CONVENTIONS, PoseConvention, poses_from_numbers

_SHOWN = [name for name in CONVENTIONS if name != "rotvec"]
_STYLES = {"x": ("solid", "0.0"), "y": ((0, (5, 1.5)), "0.3"), "z": ((0, (1, 1)), "0.0")}


def draw_conventions() -> Figure:
    """One picture a convention: the axes of the world, thin, and those that are turned, thick."""
    n_columns = 4
    n_rows = -(-len(_SHOWN) // n_columns)
    figure = plt.figure(figsize=(10, 2.55 * n_rows), layout="constrained")
    for i, name in enumerate(_SHOWN, start=1):
        ax = figure.add_subplot(n_rows, n_columns, i, projection="3d")
        _draw(ax, name, CONVENTIONS[name])
    return figure


def _draw(ax: plt.Axes, name: str, convention: PoseConvention) -> None:
    R = _rotation(convention)
    for k, (axis, (style, grey)) in enumerate(_STYLES.items()):
        for direction, width, label in ((np.eye(3)[k], 0.8, ""), (R[:, k], 2.6, axis)):
            points = np.outer([0, 1], direction)
            ax.plot(*points.T, linestyle=style, color=grey if label else "0.6", linewidth=width)
            ax.text(
                *(1.18 * direction),
                label or axis.upper(),
                color="0.0" if label else "0.5",
                fontsize=10 if label else 8,
                ha="center",
                va="center",
            )
    numbers = " ".join(f"{number:g}" for number in convention.example)
    if convention.is_matrix:
        numbers = "column by column" if convention.by_column else "row by row"
    ax.set_title(f"{name}\n{numbers}", fontsize=10)
    ax.set(xlim=(-1, 1), ylim=(-1, 1), zlim=(-1, 1))
    ax.set_box_aspect((1, 1, 1), zoom=1.4)
    ax.view_init(elev=22, azim=-58)
    ax.set_axis_off()


def _rotation(convention: PoseConvention) -> np.ndarray:
    numbers = list(convention.example)
    if convention.is_matrix:
        R = np.reshape(numbers, (3, 3))
        R = R.T if convention.by_column else R
        numbers = np.column_stack([R, np.zeros(3)]).ravel().tolist()
    else:
        numbers = [0.0, 0.0, 0.0, *numbers]
    return poses_from_numbers([numbers], convention, length_unit="m")[0, :3, :3]


if __name__ == "__main__":
    draw_conventions().savefig(sys.argv[1], dpi=110)
