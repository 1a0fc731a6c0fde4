"""Charts of a study: errors, selection and criteria, and pictures of images and vectors."""

from __future__ import annotations

import operator
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from servoscope.poses import DISPLAY_FACTORS, DOF_LABELS, DOF_UNITS, DOFS
from servoscope.report.figure import (
    ACCENT,
    INK,
    MUTED,
    SMALL,
    Layout,
    dress,
    mosaic_corners,
    new_axes,
    new_mosaic,
    plot_mosaic,
)
from servoscope.study.paper import FAMILIES, TABLE1, TABLE3, family_of
from servoscope.study.tables import CRITERIA

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
    """Filtered covariance (n, height, width), black for 0, with crosses at the chosen rows and
    columns.
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


SELECTED, PUBLISHED = "selected by information", "published, 2001"


def plot_family_errors(
    results: dict[str, Any], *, published: bool = False, ax: Axes | None = None
) -> Axes:
    """RMS error of every family, and of the selected features, by degree of freedom.

    Under each stands the error of the best family in mm or degrees; published errors are marked by
    dashes if asked for.
    """
    ax = new_axes() if ax is None else ax
    places = np.arange(len(DOFS))
    offsets = np.linspace(-0.3, 0.3, len(FAMILIES) + 1)
    for family, offset in zip(FAMILIES, offsets, strict=False):
        errors = [results["table1"][family][dof]["rms"] for dof in DOFS]
        style: dict[str, Any] = {**FAMILIES[family].style, "label": FAMILIES[family].title}
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
            f"{DOF_LABELS[dof]}\n{FAMILIES[best].title}: {cell['physical']:.2g} {cell['unit']}"
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


STEP = 4
"""The step of the selection that the plane shows, from 1; the paper shows the fourth too."""

CHARTS = Layout(3, 2.7, 1.9, gap_x=0.6, gap_y=0.62, left=0.5, right=0.08, bottom=0.4, top=0.25)


def plot_best_feature(
    values: ArrayLike, displacement: ArrayLike, name: str, dof: str, *, ax: Axes | None = None
) -> Axes:
    """A degree of freedom, in mm or degrees, against a feature."""
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

    The relevance of each candidate and its redundancy with the features selected before, NaN for
    those, are in bits.
    """
    ax = new_axes() if ax is None else ax
    relevance, redundancy = np.asarray(relevance), np.asarray(redundancy)
    remain = np.flatnonzero(~np.isnan(redundancy))
    ideal = relevance[remain].max()
    chosen = remain[np.argmin(np.hypot(redundancy[remain], ideal - relevance[remain]))]
    right, top = 1.08 * redundancy[remain].max() + 1e-3, 1.2 * ideal + 1e-3
    _draw_contours(ax, ideal, right, top)
    for family in ("gm", "pca", "pci"):
        members = [i for i in remain if family_of(names[i]) == family]
        style: dict[str, Any] = {**FAMILIES[family].style, "markersize": 3, "markeredgewidth": 0}
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


Steps = list[dict[str, float]]

REDUNDANCY_CHARTS = Layout(
    3, 2.7, 1.5, gap_x=0.6, gap_y=0.62, left=0.5, right=0.08, bottom=0.4, top=0.25
)


def plot_redundancy(steps: Steps, *, dof: str, ax: Axes | None = None) -> Axes:
    """Redundancy of the feature selected at each step, its bias, and that of unrelated features,
    [bits].
    """
    ax = new_axes() if ax is None else ax
    number = np.arange(1, len(steps) + 1)
    redundancy, bias, unrelated = (
        [step[part] for step in steps] for part in ("redundancy", "bias", "unrelated")
    )
    ax.plot(number, redundancy, "o-", color=INK, markersize=2.6, linewidth=1, label="redundancy")
    ax.fill_between(number, bias, color=MUTED, alpha=0.25, linewidth=0)
    ax.plot(number, bias, "--", color=MUTED, linewidth=1, label="bias")
    ax.plot(number, unrelated, ":", color=INK, linewidth=1, label="unrelated features")
    ax.set(xlim=(1, max(len(steps), 2)), ylim=(0, None))
    return dress(ax, title=DOF_LABELS[dof], xlabel="step", ylabel="[bits]")


def draw_redundancies(by_dof: dict[str, Steps]) -> Figure:
    """Redundancy and bias of each degree of freedom."""
    figure, panels = REDUNDANCY_CHARTS.make(len(DOFS))
    for dof, ax in zip(DOFS, panels, strict=True):
        plot_redundancy(by_dof[dof], dof=dof, ax=ax)
    panels[0].legend(fontsize=SMALL, frameon=False, loc="upper left")
    return figure


SWEEP_CHARTS = Layout(
    3, 2.4, 1.75, gap_x=0.95, gap_y=0.62, left=0.45, right=0.5, bottom=0.4, top=0.3
)


def plot_sweep(
    sweep: list[dict[str, Any]],
    *,
    dof: str,
    scale: float | None,
    decided_on_test: bool = False,
    published: float | None = None,
    ax: Axes | None = None,
) -> Axes:
    """RMS error of the subsets of a threshold sweep, with the number of features of each.

    `scale` is the range of the dof, [mm] or [deg], for the second axis; one curve is of both where
    validation and test are the same images; the least error that was published is a line.
    """
    ax = new_axes() if ax is None else ax
    thresholds = [point["thresholds"][0] for point in sweep]
    errors = [point["rms"] for point in sweep]
    if not decided_on_test:
        decided = [point["validation_rms"] for point in sweep]
        ax.plot(thresholds, decided, "s--", color=MUTED, markersize=2.6, linewidth=0.8)
    ax.plot(thresholds, errors, "o-", color=INK, markersize=3, linewidth=1)
    if published is not None:
        ax.axhline(published, color=ACCENT, linewidth=0.8, linestyle=":")
    for threshold, error, point in zip(thresholds, errors, sweep, strict=True):
        above = decided_on_test or error >= point["validation_rms"]
        place: dict[str, Any] = {
            "xytext": (0, 4 if above else -8.5),
            "textcoords": "offset points",
            "ha": "center",
        }
        ax.annotate(str(point["n_features"]), (threshold, error), fontsize=SMALL - 1.5, **place)
    ax.set_ylim(0, 1.18 * max(*errors, published or 0.0, ax.get_ylim()[1] / 1.1, 1e-6))
    dress(ax, title=DOF_LABELS[dof], xlabel="threshold [bits]", ylabel="RMS [of range]")
    scale = scale or 1.0  # None for a dof that never moved
    functions = (partial(operator.mul, scale), partial(operator.mul, 1 / scale))
    second = ax.secondary_yaxis("right", functions=functions)
    second.set_ylabel(f"[{DOF_UNITS[dof]}]", fontsize=SMALL, color=MUTED, labelpad=1)
    second.tick_params(labelsize=SMALL - 0.5, length=2.5, width=0.6, colors=MUTED)
    second.spines["right"].set(linewidth=0.6, color=MUTED)
    return ax


def draw_sweeps(
    sweeps: dict[str, list[dict[str, Any]]],
    ranges: dict[str, dict[str, Any]],
    published: dict[str, float],
    *,
    decided_on_test: bool,
) -> Figure:
    """The threshold sweep of each degree of freedom."""
    figure, panels = SWEEP_CHARTS.make(len(DOFS))
    for dof, ax in zip(DOFS, panels, strict=True):
        plot_sweep(
            sweeps[dof],
            dof=dof,
            scale=ranges[dof]["value"],
            decided_on_test=decided_on_test,
            published=published.get(dof),
            ax=ax,
        )
    return figure


CRITERION_STYLES = {
    "ideal_point": {"color": INK, "marker": "o", "linestyle": "-"},
    "ideal_point_corrected": {"color": INK, "marker": "o", "linestyle": ":"},
    "jmi": {"color": MUTED, "marker": "^", "linestyle": "--"},
    "forecast": {"color": ACCENT, "marker": "D", "linestyle": "-"},
}
"""Each criterion has its own marker and dashes, so that colour is never needed."""

CRITERION_CHARTS = Layout(
    3, 2.7, 1.9, gap_x=0.6, gap_y=0.62, left=0.5, right=0.08, bottom=1.05, top=0.25
)


def plot_criteria(
    errors: Mapping[str, Sequence[float]],
    sizes: Sequence[int],
    *,
    all_candidates: float,
    title: str = "",
    ax: Axes | None = None,
) -> Axes:
    """Errors of nets, of range, with as many features as each criterion selected first; a line for
    all.
    """
    ax = new_axes() if ax is None else ax
    places = range(len(sizes))
    for name, of_sizes in errors.items():
        own = CRITERION_STYLES.get(name, {})  # older runs have criteria that are gone
        style: dict[str, Any] = {"markersize": 3.2, "linewidth": 1, **own}
        ax.plot(places, of_sizes, label=CRITERIA.get(name, name), **style)
    ax.axhline(all_candidates, color=INK, linewidth=0.5, label="all candidates")
    ax.set_ylim(0, None)
    dress(ax, title=title, xlabel="number of features", ylabel="RMS [of range]")
    ax.set_xticks(places, [str(size) for size in sizes])
    return ax


def draw_criteria(compared: Mapping[str, Any]) -> Figure:
    """The criteria side by side, a panel a degree of freedom that moves."""
    everything = compared["all_candidates"]
    figure, panels = CRITERION_CHARTS.make(len(everything))
    for dof, ax in zip(everything, panels, strict=True):
        errors = {name: by_dof[dof] for name, by_dof in compared["errors"].items()}
        plot_criteria(
            errors,
            compared["sizes"],
            all_candidates=everything[dof],
            title=DOF_LABELS[dof],
            ax=ax,
        )
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(
        handles,
        labels,
        loc="lower left",
        ncols=4 if len(panels) > 1 else 2,
        fontsize=SMALL,
        frameon=False,
        handlelength=2.5,
        columnspacing=1.2,
    )
    return figure
