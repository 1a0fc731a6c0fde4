"""The figure of the families: mean error in clean and in disturbed images, a row a family."""

from __future__ import annotations

from collections.abc import Collection, Mapping

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.figure import Figure

SHOWN = {
    "clean": ("o", "0.0", "0.0"),
    "gain": ("|", "0.0", "0.0"),
    "covering": ("s", "0.0", "0.6"),
    "light": ("^", "0.0", "none"),
    "noise": ("x", "0.45", "0.45"),
    "defocus": ("D", "0.45", "none"),
}
"""Marker, its edge and its face of each condition; they differ in shape, for print in grey."""


def draw_errors(means: Mapping[str, Mapping[str, float]], published: Collection[str]) -> Figure:
    """Mean errors by family and condition, families in the order given, from the top.

    Parameters
    ----------
    means : mapping of mappings
        Mean error by family, then by condition.
    published : collection of str
        Families whose names are set in italics.
    """
    height = 0.9 + 0.3 * len(means)
    figure, ax = plt.subplots(figsize=(7.5, height), layout="constrained")
    rows = range(len(means))
    for condition, (marker, edge, face) in SHOWN.items():
        errors = [of_family[condition] for of_family in means.values()]
        ax.plot(
            errors,
            rows,
            linestyle="none",
            marker=marker,
            markeredgecolor=edge,
            markerfacecolor=face,
            markersize=9 if marker == "|" else 5.5,
            zorder=4 if condition == "clean" else 3,
            label=condition,
        )
    ax.hlines(rows, 0, 1, transform=ax.get_yaxis_transform(), color="0.88", linewidth=0.6, zorder=0)
    ax.set(xscale="log", xlabel="mean RMS error [of range], log scale")
    ax.set_yticks(rows, [name.replace("_", " ") for name in means])
    for label, name in zip(ax.get_yticklabels(), means, strict=True):
        label.set_style("italic" if name in published else "normal")
    ax.invert_yaxis()
    figure.legend(loc="outside upper center", ncols=len(SHOWN), frameon=False)
    return figure
