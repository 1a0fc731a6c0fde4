"""One picture that tells a study: what the camera sees, and how accurate each family is."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from servoscope.features.moments import PAPER_SLICES
from servoscope.poses import DOFS
from servoscope.report.figures.panels import ACCENT, FAMILY_STYLES, MUTED, SMALL, dress, new_axes
from servoscope.report.figures.pictures import plot_image, plot_slice
from servoscope.report.names import DOF_LABELS
from servoscope.study.paper import FAMILIES, FAMILY_TITLES

SELECTED = "selected by information"


def plot_family_errors(results: dict[str, Any], *, ax: Axes | None = None) -> Axes:
    """RMS error of every family, and of the selected features, by degree of freedom.

    Parameters
    ----------
    results : dict
        Of one protocol and displacement form: ``table1`` and ``table3`` are used. Under each
        degree of freedom stands the error of the selected features in mm or degrees.
    """
    ax = new_axes() if ax is None else ax
    places = np.arange(len(DOFS))
    offsets = np.linspace(-0.3, 0.3, len(FAMILIES) + 1)
    for family, offset in zip(FAMILIES, offsets, strict=False):
        errors = [results["table1"][family][dof]["rms"] for dof in DOFS]
        style = {**FAMILY_STYLES[family], "label": FAMILY_TITLES[family]}
        ax.plot(places + offset, errors, linestyle="", markersize=5, markeredgewidth=0, **style)
    selected = [results["table3"][dof] for dof in DOFS]
    rms = [cell["rms"] for cell in selected]
    star = {"linestyle": "", "marker": "*", "color": ACCENT, "markersize": 9}
    ax.plot(places + offsets[-1], rms, label=SELECTED, **star)
    for place in places[1:]:
        ax.axvline(place - 0.5, color=MUTED, linewidth=0.3)
    dress(ax, ylabel="RMS error on test images [of range]")
    ax.set(xlim=(-0.5, len(DOFS) - 0.5), ylim=(0, None))
    ax.set_xticks(
        places,
        [
            f"{DOF_LABELS[dof]}\n{cell['physical']:.2g} {cell['unit']}"
            for dof, cell in zip(DOFS, selected, strict=True)
        ],
    )
    ax.legend(fontsize=SMALL, ncols=3, frameon=False, loc="lower left", bbox_to_anchor=(0, 1.0))
    return ax


def draw_overview(reference_image: NDArray[np.uint8], results: dict[str, Any]) -> Figure:
    """The reference image, its three slices, and the errors of all families."""
    height, width = reference_image.shape
    picture = 2.7
    small = picture / 3 - 0.1
    tall = picture * min(max(height / width, 0.5), 1.3)
    total_x, total_y = 9.6, tall + 0.75
    figure = Figure(figsize=(total_x, total_y), facecolor="white")

    def place(x: float, y: float, w: float, h: float) -> Axes:
        return figure.add_axes((x / total_x, y / total_y, w / total_x, h / total_y))

    plot_image(reference_image, title="what the camera sees", ax=place(0.1, 0.45, picture, tall))
    step = tall / 3
    for i, (lower, upper) in enumerate(PAPER_SLICES):
        box = place(picture + 0.25, 0.45 + (2 - i) * step, small, step - 0.17)
        plot_slice(reference_image, lower, upper, ax=box)
    chart = place(picture + small + 0.95, 0.45, total_x - picture - small - 1.05, tall - 0.12)
    plot_family_errors(results, ax=chart)
    return figure
