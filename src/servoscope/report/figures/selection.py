"""Charts of the selection: the best feature (figure 9) and the selection plane (figure 10)."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from servoscope.poses import DISPLAY_FACTORS, DOFS
from servoscope.report.figures.panels import (
    ACCENT,
    FAMILY_STYLES,
    INK,
    MUTED,
    SMALL,
    Layout,
    dress,
    new_axes,
)
from servoscope.report.names import DOF_LABELS, DOF_UNITS, feature_family

STEP = 4
"""The step of the selection that the plane shows, from 1; the paper shows the fourth too."""

CHARTS = Layout(3, 2.7, 1.9, gap_x=0.6, gap_y=0.62, left=0.5, right=0.08, bottom=0.4, top=0.25)


def plot_best_feature(
    values: ArrayLike, displacement: ArrayLike, name: str, dof: str, *, ax: Axes | None = None
) -> Axes:
    """A degree of freedom, in mm or degrees, against a feature.

    Parameters
    ----------
    values : array of shape (n_images,)
        The feature.
    displacement : array of shape (n_images,)
        [mm] or [deg].
    name, dof : str
    """
    ax = new_axes() if ax is None else ax
    ax.plot(values, displacement, ".", color=INK, markersize=2.8, markeredgewidth=0, alpha=0.8)
    return dress(ax, xlabel=name, ylabel=f"{DOF_LABELS[dof]} [{DOF_UNITS[dof]}]")


def plot_selection_plane(
    relevance: ArrayLike,
    redundancy: ArrayLike,
    names: list[str],
    *,
    title: str = "",
    ax: Axes | None = None,
) -> Axes:
    """The candidates of one step, and contours of their distance to the ideal point.

    Parameters
    ----------
    relevance : array of shape (n_candidates,)
        Information of each candidate about the degree of freedom, [bits].
    redundancy : array of shape (n_candidates,)
        Sum of its information about the features selected before, [bits]; NaN for those.
    names : list of n_candidates str
    """
    ax = new_axes() if ax is None else ax
    relevance, redundancy = np.asarray(relevance), np.asarray(redundancy)
    remain = np.flatnonzero(~np.isnan(redundancy))
    ideal = relevance[remain].max()
    chosen = remain[np.argmin(np.hypot(redundancy[remain], ideal - relevance[remain]))]
    right, top = 1.08 * redundancy[remain].max() + 1e-3, 1.2 * ideal + 1e-3
    _draw_contours(ax, ideal, right, top)
    for family in ("gm", "pca", "pci"):
        members = [i for i in remain if feature_family(names[i]) == family]
        style: dict[str, Any] = {**FAMILY_STYLES[family], "markersize": 3, "markeredgewidth": 0}
        ax.plot(redundancy[members], relevance[members], linestyle="", **style)
    x, y = redundancy[chosen], relevance[chosen]
    ax.plot(x, y, "o", markersize=9, markerfacecolor="none", markeredgecolor=ACCENT)
    _name_point(ax, names[chosen], x, y, right)
    ax.set(xlim=(0, right), ylim=(0, top))
    return dress(ax, title=title, xlabel="sum of I(f; f_k) [bits]", ylabel="I(f; y) [bits]")


def draw_best_features(
    values: dict[str, NDArray[Any]], names: dict[str, str], delta_p: NDArray[np.float64]
) -> Figure:
    """The first feature selected for each degree of freedom against it."""
    figure, panels = CHARTS.make(len(DOFS))
    shown = delta_p * DISPLAY_FACTORS
    for i, (dof, ax) in enumerate(zip(DOFS, panels, strict=True)):
        plot_best_feature(values[dof], shown[:, i], names[dof], dof, ax=ax)
    return figure


def draw_selection_planes(
    relevance: dict[str, NDArray[np.float64]],
    redundancy: dict[str, NDArray[np.float64]],
    names: list[str],
) -> Figure:
    """The selection plane of each degree of freedom at the same step."""
    figure, panels = CHARTS.make(len(DOFS))
    for dof, ax in zip(DOFS, panels, strict=True):
        title = DOF_LABELS[dof]
        plot_selection_plane(relevance[dof], redundancy[dof], names, title=title, ax=ax)
    return figure


def _draw_contours(ax: Axes, ideal: float, right: float, top: float) -> None:
    angles = np.linspace(-np.pi / 2, np.pi / 2, 181)[:, None]
    radii = np.linspace(0, np.hypot(right, max(ideal, top - ideal)), 11)[1:-1]
    x, y = radii * np.cos(angles), ideal + radii * np.sin(angles)
    ax.plot(x, y, color=MUTED, linewidth=0.5, alpha=0.7, label="_contour")


def _name_point(ax: Axes, name: str, x: float, y: float, right: float) -> None:
    left_half = x < 0.6 * right
    ax.annotate(
        name,
        (x, y),
        xytext=(7 if left_half else -7, 5),
        textcoords="offset points",
        ha="left" if left_half else "right",
        fontsize=SMALL,
        color=INK,
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6, "alpha": 0.85},
    )
