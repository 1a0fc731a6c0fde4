"""A rehearsal as a table, figures and a page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from servoscope.rehearsal.run import ENOUGH
from servoscope.report.figure import (
    ACCENT,
    INK,
    MUTED,
    SMALL,
    Caption,
    FigureOrder,
    Layout,
    draw_figures,
    dress,
    new_axes,
    new_mosaic,
    plot_mosaic,
)
from servoscope.report.page import Section, Verdict, pairs, write_page
from servoscope.report.table import Table, write_tables
from servoscope.scoreboard.trial import SUCCESS_DEG, SUCCESS_MM
from servoscope.wording import listing

LEGEND = (
    f"arrive: starts that ended under {SUCCESS_MM:g} mm and under {SUCCESS_DEG:g} deg; the "
    "interval is Wilson's; end: median of all starts; moves: median of those that arrived; wrongly "
    "converged: said so, but ended farther away."
)

SUCCESS = Caption(
    "Success by condition",
    f"Share of the starts that arrive, with its 95 % interval; squares: less than {ENOUGH:.0%}.",
    "A chart with a line for each condition: the share of the starts that arrive.",
)
STARTS = Caption(
    "Starts that fail",
    "Each start by its root mean square displacement in shares of the range; squares: did not "
    "arrive.",
    "Charts of the starts, one for each condition: translation across, rotation upwards.",
)
EXAMPLES = Caption(
    "What the camera sees",
    "The reference, and the image of the first start under each condition.",
    "The reference image and a rendered image for each condition.",
)

_THUMBNAIL = 240

MADE = (
    "The images are rendered of the reference view with the depth that training found, seen from "
    "the starts; its relief and what is read of it are off by as much as the images of training "
    "were. What the reference does not show is a plane on which the view goes on, mirrored."
)

Results = Mapping[str, Mapping[str, Any]]
"""By condition, what `Rehearsal.run` returns."""


def plot_success(results: Results, *, enough: float, ax: Axes | None = None) -> Axes:
    """Share of the starts that arrive under each condition, with its 95 % interval and a line at
    `enough`.
    """
    ax = new_axes() if ax is None else ax
    dress(ax, xlabel="starts that arrive [%]")
    for row, numbers in enumerate(results.values()):
        share = 100 * numbers["success"] / numbers["trials"]
        low, high = (100 * bound for bound in numbers["success_interval"])
        is_enough = share >= 100 * enough
        color = INK if is_enough else ACCENT
        ax.plot([low, high], [row, row], color=color, linewidth=1.0)
        ax.plot(share, row, "o" if is_enough else "s", color=color, markersize=5)
    ax.axvline(100 * enough, color=MUTED, linewidth=0.6, linestyle=":")
    ax.set(xlim=(-2, 103), ylim=(len(results) - 0.5, -0.5))
    ax.set_yticks(range(len(results)), list(results))
    return ax


def draw_success(results: Results, enough: float) -> Figure:
    """The chart of `plot_success`."""
    layout = Layout(1, 3.1, 0.24 * len(results) + 0.1, left=1.0, bottom=0.45, top=0.1, right=0.15)
    figure, (ax,) = layout.make(1)
    plot_success(results, enough=enough, ax=ax)
    return figure


def plot_starts(
    starts: Sequence[Mapping[str, Any]], *, title: str = "", ax: Axes | None = None
) -> Axes:
    """Where in the range the starts lie, as ``shares`` of it, and which of them do not arrive."""
    ax = new_axes() if ax is None else ax
    dress(ax, title=title)
    shares = np.abs([start["shares"] for start in starts])
    arrived = np.array([start["succeeded"] for start in starts], dtype=bool)
    x, y = (np.sqrt((part**2).mean(axis=1)) for part in (shares[:, :3], shares[:, 3:]))
    ax.plot(x[arrived], y[arrived], "o", color=MUTED, markersize=3.5, fillstyle="none")
    ax.plot(x[~arrived], y[~arrived], "s", color=ACCENT, markersize=4)
    most = max(1.0, float(shares.max()))
    ax.set(xlim=(0, most), ylim=(0, most), xticks=(0, 0.5, 1), yticks=(0, 0.5, 1))
    return ax


def draw_starts(results: Results) -> Figure:
    """A panel for each condition, five in a row."""
    layout = Layout(5, 1.3, 1.3, gap_x=0.3, gap_y=0.45, left=0.55, right=0.15, bottom=0.45, top=0.3)
    figure, axes = layout.make(len(results))
    for ax, (name, numbers) in zip(axes, results.items(), strict=True):
        plot_starts(numbers["starts"], title=name, ax=ax)
    for ax in axes[:: layout.n_columns]:
        ax.set_ylabel("rotation [of range]", fontsize=SMALL, color=INK, labelpad=2)
    for ax in axes[-layout.n_columns :]:
        ax.set_xlabel("translation [of range]", fontsize=SMALL, color=INK, labelpad=2)
    return figure


def draw_examples(images: Mapping[str, NDArray[np.uint8]]) -> Figure:
    """The images row by row, each with its name above."""
    pictures = list(images.values())
    figure, ax = new_mosaic(pictures[0].shape, len(pictures), n_columns=4, width=1.8)
    plot_mosaic(pictures, list(images), n_columns=4, ax=ax, cmap="gray", vmin=0, vmax=255)
    return figure


def rehearsal_table(rehearsal: Mapping[str, Any]) -> Table:
    """A row for each condition."""
    return Table(
        ["condition", "arrive", "95 % interval", "end [mm]", "end [deg]", "moves",
         "wrongly converged", "how they ended"],
        [
            (
                name,
                f"{numbers['success']}/{numbers['trials']}",
                "{:.0%} to {:.0%}".format(*numbers["success_interval"]),
                f"{numbers['final_mm_median']:.3g}",
                f"{numbers['final_deg_median']:.2g}",
                "-" if numbers["moves_median"] is None else f"{numbers['moves_median']:g}",
                str(numbers["wrongly_converged"]),
                ", ".join(f"{n} {status}" for status, n in numbers["status_counts"].items()),
            )
            for name, numbers in rehearsal["results"].items()
        ],
        f"{rehearsal['starts']} starts each, range 1.0: {range_text(rehearsal['ranges'])}",
        LEGEND,
        align="l",
    )  # fmt: skip


def write_rehearsal(
    folder: Path, rehearsal: Mapping[str, Any], images: Mapping[str, NDArray[np.uint8]]
) -> Path:
    """Write ``rehearsal.html``, which needs nothing else, ``rehearsal.md`` and ``figures/``;
    returns the page. `images` has one for each condition.
    """
    results, table = rehearsal["results"], rehearsal_table(rehearsal)
    shown = {name: _thumbnail(image) for name, image in images.items()}
    orders = [
        FigureOrder("success", SUCCESS, partial(draw_success, results, ENOUGH)),
        FigureOrder("starts", STARTS, partial(draw_starts, results)),
        FigureOrder("examples", EXAMPLES, partial(draw_examples, shown)),
    ]
    figures = draw_figures(orders, folder / "figures", n_jobs=1)
    write_tables(folder / "rehearsal.md", [table], words=[rehearsal["verdict"], LEGEND])
    timings = {"Time by stage [s]": rehearsal["timings_s"].items()}
    success, *others = figures
    sections = [
        *(Section(figure.caption.title, [figure]) for figure in others),
        Section("How it was made", [MADE, pairs(timings), f"Seed {rehearsal['seed']}."]),
    ]
    return write_page(
        folder / "rehearsal.html",
        f"Rehearsal of {rehearsal['model']}",
        rehearsal_verdict(rehearsal),
        [table, success],
        sections,
        kind="rehearse",
        lead="Whether the camera would arrive at its reference view, under each condition, in "
        "images rendered of that view.",
    )


def rehearsal_verdict(rehearsal: Mapping[str, Any]) -> Verdict:
    """Whether the camera would arrive, and what to do next."""
    results = rehearsal["results"]
    weak = [name for name, of in results.items() if of["success"] < ENOUGH * of["trials"]]
    wrong = [name for name, of in results.items() if of["wrongly_converged"]]
    said = rehearsal["verdict"]
    if not weak and not wrong:
        return Verdict(f"Yes. {said}", "position the robot: servoscope position MODEL.", "yes")
    keep = f"keep {listing(list(dict.fromkeys([*wrong, *weak])))} away from the robot, or "
    known = "range_1.0" in results and "range_1.0" not in (*weak, *wrong)
    step = (
        "rehearse from nearer, servoscope rehearse MODEL --range-mm --range-deg, or train on more "
        "images."
    )
    return Verdict(f"No, not safely. {said}", f"{keep}{step}" if known else step, "no")


def range_text(ranges: Mapping[str, Mapping[str, Any]]) -> str:
    """Largest displacements of a start, such as ``tx 25 mm, rz 15 deg``."""
    return ", ".join(f"{dof} {of['value']:.3g} {of['unit']}" for dof, of in ranges.items())


def _thumbnail(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    scale = min(1.0, _THUMBNAIL / image.shape[1])
    size = (round(scale * image.shape[1]), round(scale * image.shape[0]))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
