"""Figures: panels laid out by hand, the look that all share, and how they become files."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from html import escape
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from markupsafe import Markup
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from servoscope.processes import in_processes
from servoscope.storage.folders import write_atomically

INK, MUTED, ACCENT = "#1c2733", "#6b7782", "#b3501e"
SMALL, NORMAL = 7.5, 8.5

DOF_STYLES: dict[str, dict[str, Any]] = {
    "tx": {"color": INK, "marker": "o"},
    "ty": {"color": INK, "marker": "s"},
    "tz": {"color": INK, "marker": "^"},
    "rx": {"color": ACCENT, "marker": "D"},
    "ry": {"color": ACCENT, "marker": "v"},
    "rz": {"color": ACCENT, "marker": "P"},
}
"""Translations are dark, rotations in the accent; each axis has its own marker."""

GREY = 40
"""Pictures whose red and blue differ by no more than this are stored as grey: ink is tinted."""

COLOURS = 96
"""So many shades of a colour picture are stored: more are not distinguished, and fill it."""

DPI = 144
"""Pixels per inch of the files; the page shows them at 96, so they stay sharp in print."""

WIDE = 640
"""A figure wider than so many px scrolls on a phone: its letters would be too small."""

GAP, TITLE = 0.1, 0.2
"""Space between the pictures of a mosaic, and above each, as shares of a picture's width."""

FRAME: dict[str, Any] = {"color": MUTED, "linewidth": 0.5, "scalex": False, "scaley": False}


@dataclass(frozen=True)
class Caption:
    """Words of a figure:

    its title, what one sees, what is read aloud in its place, and the figure of the paper that it
    is the counterpart of.
    """

    title: str
    text: str
    alt: str
    paper_figure: int | None = None


@dataclass(frozen=True, eq=False)
class FigureOrder:
    """A figure to be drawn:

    the name of its file, without the ending, its caption, and what returns the Figure, which can be
    sent to another process.
    """

    name: str
    caption: Caption
    draw: Callable[[], Figure]


@dataclass(frozen=True)
class FigureFile:
    """A figure that was drawn: its PNG, its size on the page in px, its words, and its SVG."""

    name: str
    caption: Caption
    png: bytes
    width: int
    height: int
    svg: bytes = b""

    def to_html(self) -> str:
        """The figure as part of a page, with its pixels in the page itself."""
        words = f"<b>{escape(self.caption.title)}.</b> {escape(self.caption.text)}"
        if self.caption.paper_figure:
            of = f"Counterpart of the paper's figure {self.caption.paper_figure}."
            words += f' <span class="quiet">{of}</span>'
        image = (
            f'<img src="data:image/png;base64,{base64.b64encode(self.png).decode("ascii")}" '
            f'width="{self.width}" height="{self.height}" alt="{escape(self.caption.alt)}">'
        )
        if self.width > WIDE:
            label = escape(self.caption.title)
            image = (
                f'<div class="scroll wide" role="group" aria-label="{label}" tabindex="0">\n'
                f"{image}\n</div>"
            )
        return f"<figure>\n{image}\n<figcaption>{words}</figcaption>\n</figure>"

    def __html__(self) -> Markup:
        return Markup(self.to_html())  # noqa: S704


def draw_figures(
    orders: list[FigureOrder], folder: Path, *, n_jobs: int = -1, svg: bool = False
) -> list[FigureFile]:
    """Draw figures, several at a time, and write each as a PNG file into a folder.

    With `svg` each is an SVG file beside it as well, for print.
    """
    folder.mkdir(exist_ok=True)
    files = list(in_processes(render, ((order, svg) for order in orders), n_jobs))
    for file in files:
        write_atomically(folder / f"{file.name}.png", partial(_write, content=file.png))
        if svg:
            write_atomically(folder / f"{file.name}.svg", partial(_write, content=file.svg))
    return files


def to_svg(figure: Figure) -> bytes:
    """A figure as SVG, its letters as curves; equal figures give equal bytes."""
    svg = io.BytesIO()
    with rc_context({"svg.hashsalt": "servoscope"}):
        figure.savefig(svg, format="svg", metadata={"Date": None})
    return svg.getvalue()


def render(order: FigureOrder, svg: bool = False) -> FigureFile:
    """Draw one figure."""
    figure = order.draw()
    figure.set_dpi(DPI)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())[..., :3]
    png = io.BytesIO()
    _with_few_colours(pixels).save(png, "PNG")
    width, height = (round(side * 96 / DPI) for side in pixels.shape[1::-1])
    drawn = to_svg(figure) if svg else b""
    return FigureFile(order.name, order.caption, png.getvalue(), width, height, drawn)


def _write(out: BinaryIO, content: bytes) -> None:
    out.write(content)


def _with_few_colours(pixels: NDArray[np.uint8]) -> Image.Image:
    """All the greys of a grey picture, `COLOURS` of another: a quarter of the page's size."""
    image = Image.fromarray(np.ascontiguousarray(pixels))
    red, blue = pixels[..., 0].astype(np.int16), pixels[..., 2].astype(np.int16)
    if np.abs(red - blue).max() <= GREY:
        return image.convert("L")
    return image.quantize(COLOURS, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)


@dataclass(frozen=True)
class Layout:
    """Where panels of one size stand; all lengths in inches."""

    n_columns: int
    width: float
    height: float
    gap_x: float = 0.12
    gap_y: float = 0.3
    left: float = 0.05
    right: float = 0.05
    bottom: float = 0.05
    top: float = 0.25

    def make(self, n_panels: int) -> tuple[Figure, list[Axes]]:
        """A figure and its panels, row by row."""
        n_columns = min(self.n_columns, n_panels)
        n_rows = -(-n_panels // n_columns)
        total_x = self.left + n_columns * (self.width + self.gap_x) - self.gap_x + self.right
        total_y = self.bottom + n_rows * (self.height + self.gap_y) - self.gap_y + self.top
        figure = Figure(figsize=(total_x, total_y), facecolor="white")
        panels = []
        for i in range(n_panels):
            row, column = divmod(i, n_columns)
            x = self.left + column * (self.width + self.gap_x)
            y = total_y - self.top - row * (self.height + self.gap_y) - self.height
            box = (x / total_x, y / total_y, self.width / total_x, self.height / total_y)
            panels.append(figure.add_axes(box))
        return figure, panels


def new_axes() -> Axes:
    """Axes of a figure of their own."""
    return Figure(figsize=(3.2, 2.6), layout="constrained").add_subplot()


def dress(
    ax: Axes, *, title: str = "", xlabel: str = "", ylabel: str = "", is_log: bool = False
) -> Axes:
    """Give axes of a chart their words and their quiet look; logarithms keep their own ticks."""
    words: dict[str, Any] = {"fontsize": SMALL, "color": INK, "labelpad": 2}
    ax.set_xlabel(xlabel, **words)
    ax.set_ylabel(ylabel, **words)
    ax.set_title(title, fontsize=NORMAL, color=INK, pad=4)
    ax.tick_params(labelsize=SMALL - 0.5, length=2.5, width=0.6, colors=MUTED, labelcolor=INK)
    if is_log:
        ax.yaxis.set_major_formatter("{x:g}")
        ax.tick_params(which="minor", labelsize=SMALL - 0.5, width=0.6, colors=MUTED)
    else:
        ax.locator_params(nbins=5)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        ax.spines[side].set(linewidth=0.6, color=MUTED)
    return ax


def plot_mosaic(
    pictures: Sequence[NDArray[Any]] | NDArray[Any],
    titles: Sequence[str],
    *,
    n_columns: int = 6,
    ax: Axes | None = None,
    **mapping: Any,
) -> Axes:
    """Pictures row by row, each with its title above; `mapping`, as of ``imshow``, turns values to
    colours.
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
