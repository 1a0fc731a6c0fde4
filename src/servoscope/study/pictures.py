"""Pictures: images and slices (figure 3), and the vectors of the families (figures 4 to 8)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from servoscope.poses import DOF_LABELS, DOFS
from servoscope.report.figure import mosaic_corners, new_mosaic, plot_mosaic

Array = NDArray[Any]
Slices = Sequence[tuple[int, int]]

SIGNED = LinearSegmentedColormap.from_list(
    "signed", ["#08203f", "#3f6287", "#a3a5a6", "#e3b98a", "#fff6e6"], N=128
)
"""Dark blue for negative, middle grey for zero, pale orange for positive: lightness alone shows
the sign, so that a grey print reads the same."""

GREYS: dict[str, Any] = {"cmap": "gray", "vmin": 0, "vmax": 255}


def plot_slices(
    image: ArrayLike, slices: Slices, *, n_columns: int = 6, ax: Axes | None = None
) -> Axes:
    """The pixels of each ``lower <= grey < upper``, stretched over the greys, on white."""
    shown, titles = _stretched_slices(np.asarray(image), slices)
    return plot_mosaic(shown, titles, n_columns=n_columns, ax=ax, **GREYS)


def plot_signed(
    vectors: ArrayLike, titles: Sequence[str], *, n_columns: int = 6, ax: Axes | None = None
) -> Axes:
    """Signed pictures, each on its own scale, zero in the middle of the map."""
    mapping: dict[str, Any] = {"cmap": SIGNED, "vmin": -1, "vmax": 1}
    return plot_mosaic(_unit_scale(vectors), titles, n_columns=n_columns, ax=ax, **mapping)


def plot_locations(
    filtered: ArrayLike,
    locations: ArrayLike,
    titles: Sequence[str],
    *,
    n_columns: int = 6,
    ax: Axes | None = None,
) -> Axes:
    """Filtered covariance, black for 0, with crosses at the chosen rows and columns.

    Parameters
    ----------
    filtered : array of shape (n, height, width)
    locations : array of shape (n, n_locations, 2)
    titles : sequence of n str
    """
    pictures, locations = _unit_scale(filtered), np.asarray(locations)
    mapping: dict[str, Any] = {"cmap": "gray", "vmin": 0, "vmax": 1}
    ax = plot_mosaic(pictures, titles, n_columns=n_columns, ax=ax, **mapping)
    corners = mosaic_corners(pictures.shape[1:], len(pictures), n_columns)
    crosses = locations[..., ::-1] + np.array(list(corners))[:, None, :]
    for color, width in (("black", 2.2), ("white", 1.0)):
        style: dict[str, Any] = {"color": color, "markersize": 6, "markeredgewidth": width}
        ax.plot(*crosses.reshape(-1, 2).T, "+", scalex=False, scaley=False, **style)
    return ax


def draw_reference(reference_image: Array) -> Figure:
    """The reference image alone."""
    height, width = reference_image.shape
    figure = Figure(figsize=(2.7, 2.7 * height / width), facecolor="white")
    ax = figure.add_axes((0, 0, 1, 1))
    ax.imshow(reference_image, aspect="auto", **GREYS)
    ax.axis("off")
    return figure


def draw_slices(reference_image: Array, slices: Slices) -> Figure:
    """The reference image beside its intensity slices (figure 3)."""
    shown, titles = _stretched_slices(reference_image, slices)
    shown, titles = [reference_image, *shown], ["reference image", *titles]
    figure, ax = new_mosaic(reference_image.shape, len(shown), n_columns=4, width=1.8)
    plot_mosaic(shown, titles, n_columns=4, ax=ax, **GREYS)
    return figure


def draw_eigenvectors(eigenvectors: Array) -> Figure:
    """The first eigenvectors of the training images (figure 4)."""
    titles = [f"e_{i:02d}" for i in range(len(eigenvectors))]
    figure, ax = new_mosaic(eigenvectors.shape[1:], len(eigenvectors))
    plot_signed(eigenvectors, titles, ax=ax)
    return figure


def draw_signed(vectors: Array, prefix: str = "") -> Figure:
    """One signed picture for each degree of freedom (figures 5, 6 and 8)."""
    titles = [f"{prefix}{dof}" if prefix else DOF_LABELS[dof] for dof in DOFS]
    figure, ax = new_mosaic(vectors.shape[1:], len(vectors))
    plot_signed(vectors, titles, ax=ax)
    return figure


def draw_locations(filtered: Array, locations: Array) -> Figure:
    """The filtered covariance and the chosen locations of each degree of freedom (figure 7)."""
    figure, ax = new_mosaic(filtered.shape[1:], len(filtered))
    plot_locations(filtered, locations, list(DOF_LABELS.values()), ax=ax)
    return figure


def _stretched_slices(image: Array, slices: Slices) -> tuple[list[Array], list[str]]:
    """The picture and the title of each slice."""
    shown = [_stretch(image, *bounds) for bounds in slices]
    return shown, [f"grey {lower} to {upper - 1}" for lower, upper in slices]


def _stretch(image: Array, lower: int, upper: int) -> Array:
    inside = (image >= lower) & (image < upper)
    return np.where(inside, 200.0 * (image.astype(float) - lower) / (upper - lower), 255.0)


def _unit_scale(pictures: ArrayLike) -> Array:
    pictures = np.asarray(pictures)
    limits = np.abs(pictures).max(axis=(1, 2), keepdims=True)
    return pictures / np.where(limits > 0, limits, 1.0)
