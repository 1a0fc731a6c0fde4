"""Pictures: images and slices (figure 3), and the vectors of the families (figures 4 to 8)."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from servoscope.features.moments import PAPER_SLICES
from servoscope.poses import DOFS
from servoscope.report.figures.panels import INK, MUTED, NORMAL, SIGNED, new_axes, picture_layout
from servoscope.report.names import DOF_LABELS

Array = NDArray[Any]


def plot_image(image: ArrayLike, *, title: str = "", ax: Axes | None = None) -> Axes:
    """A grey image of 0 (black) to 255 (white)."""
    return _show(image, title, ax, cmap="gray", vmin=0, vmax=255)


def plot_slice(image: ArrayLike, lower: int, upper: int, *, ax: Axes | None = None) -> Axes:
    """The pixels of ``lower <= grey < upper``, stretched over the greys, on white."""
    image = np.asarray(image)
    inside = (image >= lower) & (image < upper)
    shown = np.where(inside, 200.0 * (image.astype(float) - lower) / (upper - lower), 255.0)
    return _show(shown, f"grey {lower} to {upper - 1}", ax, cmap="gray", vmin=0, vmax=255)


def plot_signed(vector: ArrayLike, *, title: str = "", ax: Axes | None = None) -> Axes:
    """A signed picture, zero in the middle of the map."""
    limit = float(np.abs(vector).max()) or 1.0
    return _show(vector, title, ax, cmap=SIGNED, vmin=-limit, vmax=limit)


def plot_magnitude(picture: ArrayLike, *, title: str = "", ax: Axes | None = None) -> Axes:
    """A picture that has no negative values, black for 0."""
    return _show(picture, title, ax, cmap="gray", vmin=0, vmax=float(np.max(picture)) or 1.0)


def plot_locations(
    filtered: ArrayLike, locations: ArrayLike, *, title: str = "", ax: Axes | None = None
) -> Axes:
    """A filtered covariance picture with crosses at the chosen rows and columns."""
    ax = plot_magnitude(filtered, title=title, ax=ax)
    rows, columns = np.asarray(locations).T
    for color, width in (("black", 2.2), ("white", 1.0)):
        ax.plot(columns, rows, "+", color=color, markersize=6, markeredgewidth=width)
    return ax


def draw_slices(reference_image: Array) -> Figure:
    """The reference image beside its three intensity slices (figure 3)."""
    figure, panels = picture_layout(reference_image.shape, 4, 1.8).make(4)
    plot_image(reference_image, title="reference image", ax=panels[0])
    for ax, (lower, upper) in zip(panels[1:], PAPER_SLICES, strict=True):
        plot_slice(reference_image, lower, upper, ax=ax)
    return figure


def draw_reference(reference_image: Array) -> Figure:
    """The reference image alone."""
    figure, (ax,) = picture_layout(reference_image.shape, 1, 2.6).make(1)
    plot_image(reference_image, title="reference image", ax=ax)
    return figure


def draw_eigenvectors(eigenvectors: Array) -> Figure:
    """The first eigenvectors of the training images (figure 4)."""
    figure, panels = picture_layout(eigenvectors.shape[1:]).make(len(eigenvectors))
    for i, (ax, vector) in enumerate(zip(panels, eigenvectors, strict=True)):
        plot_signed(vector, title=f"e_{i:02d}", ax=ax)
    return figure


def draw_signed(vectors: Array, prefix: str = "") -> Figure:
    """One signed picture for each degree of freedom (figures 5, 6 and 8)."""
    figure, panels = picture_layout(vectors.shape[1:]).make(len(DOFS))
    for dof, ax, vector in zip(DOFS, panels, vectors, strict=True):
        plot_signed(vector, title=f"{prefix}{dof}" if prefix else DOF_LABELS[dof], ax=ax)
    return figure


def draw_locations(filtered: Array, locations: Array) -> Figure:
    """The filtered covariance and the chosen locations of each degree of freedom (figure 7)."""
    figure, panels = picture_layout(filtered.shape[1:]).make(len(DOFS))
    for dof, ax, picture, chosen in zip(DOFS, panels, filtered, locations, strict=True):
        plot_locations(picture, chosen, title=DOF_LABELS[dof], ax=ax)
    return figure


def _show(picture: ArrayLike, title: str, ax: Axes | None, **mapping: Any) -> Axes:
    ax = new_axes() if ax is None else ax
    ax.imshow(picture, aspect="equal", **mapping)
    ax.set(xticks=[], yticks=[])
    ax.set_title(title, fontsize=NORMAL, color=INK, pad=3)
    for spine in ax.spines.values():
        spine.set(linewidth=0.5, color=MUTED)
    return ax
