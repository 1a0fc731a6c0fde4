"""One picture that tells a study: what the camera sees, and how accurate each family is."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from servoscope.poses import DOFS
from servoscope.report.figures.mosaic import plot_mosaic
from servoscope.report.figures.panels import (
    ACCENT,
    FAMILY_STYLES,
    INK,
    MUTED,
    SMALL,
    dress,
    new_axes,
)
from servoscope.report.figures.pictures import GREYS, Slices, plot_slices
from servoscope.report.names import DOF_LABELS
from servoscope.study.paper import FAMILIES, FAMILY_TITLES, TABLE1, TABLE3

SELECTED, PUBLISHED = "selected by information", "published, 2001"


def plot_family_errors(
    results: dict[str, Any], *, published: bool = False, ax: Axes | None = None
) -> Axes:
    """RMS error of every family, and of the selected features, by degree of freedom.

    Parameters
    ----------
    results : dict
        Of one protocol and displacement form. Under each degree of freedom stands the error of
        the best family in mm or degrees.
    published : bool
        Whether to mark the published errors, each by a dash in the place of ours.
    """
    ax = new_axes() if ax is None else ax
    places = np.arange(len(DOFS))
    offsets = np.linspace(-0.3, 0.3, len(FAMILIES) + 1)
    for family, offset in zip(FAMILIES, offsets, strict=False):
        errors = [results["table1"][family][dof]["rms"] for dof in DOFS]
        style: dict[str, Any] = {**FAMILY_STYLES[family], "label": FAMILY_TITLES[family]}
        ax.plot(places + offset, errors, linestyle="", markersize=5, markeredgewidth=0, **style)
    rms = [results["table3"][dof]["rms"] for dof in DOFS]
    cross: dict[str, Any] = {"linestyle": "", "marker": "x", "color": ACCENT, "markersize": 5}
    ax.plot(places + offsets[-1], rms, label=SELECTED, **cross)
    if published:
        rows = [TABLE1[family] for family in FAMILIES]
        rows.append({dof: float(TABLE3[dof]["rms"]) for dof in DOFS})
        theirs = np.array([[row[dof] for dof in DOFS] for row in rows])
        dash: dict[str, Any] = {"linestyle": "", "marker": "_", "color": INK, "markersize": 9}
        ax.plot((places + offsets[:, None]).ravel(), theirs.ravel(), label=PUBLISHED, **dash)
    for place in places[1:]:
        ax.axvline(place - 0.5, color=MUTED, linewidth=0.3)
    dress(ax, ylabel="RMS error on test images [of range]")
    ax.set(xlim=(-0.5, len(DOFS) - 0.5), ylim=(0, None))
    best = results["best_family"]
    least = [results["table1"][best][dof] for dof in DOFS]
    ax.set_xticks(
        places,
        [
            f"{DOF_LABELS[dof]}\n{FAMILY_TITLES[best]}: {cell['physical']:.2g} {cell['unit']}"
            for dof, cell in zip(DOFS, least, strict=True)
        ],
    )
    narrow = {"columnspacing": 1.2, "handletextpad": 0.3}
    ax.legend(
        fontsize=SMALL, ncols=4, frameon=False, loc="lower left", bbox_to_anchor=(0, 1.0), **narrow
    )
    return ax


def draw_family_errors(results: dict[str, Any], *, published: bool) -> Figure:
    """The errors of all families."""
    figure = Figure(figsize=(9.6, 3.4), facecolor="white")
    plot_family_errors(results, published=published, ax=figure.add_axes((0.06, 0.12, 0.93, 0.74)))
    return figure


def draw_overview(
    reference_image: NDArray[np.uint8],
    slices: Slices,
    results: dict[str, Any],
    *,
    published: bool,
) -> Figure:
    """The reference image, its slices, and the errors of all families."""
    ratio = min(max(reference_image.shape[0] / reference_image.shape[1], 0.5), 1.3)
    tall, total_x = 3.0, 9.6
    total_y = tall + 0.75
    figure = Figure(figsize=(total_x, total_y), facecolor="white")

    def place(x: float, width: float, height: float) -> Axes:
        return figure.add_axes(
            (x / total_x, 0.42 / total_y, width / total_x, height / total_y), anchor="SW"
        )

    picture = min(tall / ratio, 3.2)
    small = tall / (len(slices) * (ratio + 0.2))
    seen = place(0.05, picture, tall + 0.3)
    plot_mosaic([reference_image], ["what the camera sees"], ax=seen, **GREYS)
    plot_slices(reference_image, slices, n_columns=1, ax=place(picture + 0.2, small, tall + 0.1))
    left = picture + small + 0.9
    chart = place(left, total_x - left - 0.1, tall - 0.05)
    plot_family_errors(results, published=published, ax=chart)
    return figure
