"""How figures become files: several at a time, in processes that import no more than drawing."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import BinaryIO

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from servoscope.files import write_atomically
from servoscope.processes import in_processes
from servoscope.report.figures.captions import Caption

GREY = 40
"""Pictures whose red and blue differ by no more than this are stored as grey: ink is tinted."""

DPI = 144
"""Pixels per inch of the files; the page shows them at 96, so they stay sharp in print."""


@dataclass(frozen=True, eq=False)
class FigureOrder:
    """A figure to be drawn.

    Parameters
    ----------
    name : str
        Of its file, without the ending.
    caption : Caption
    draw : callable
        Returns the Figure; can be sent to another process.
    """

    name: str
    caption: Caption
    draw: Callable[[], Figure]


@dataclass(frozen=True)
class FigureFile:
    """A figure that was drawn: its PNG, its size on the page in px, and its words."""

    name: str
    caption: Caption
    png: bytes
    width: int
    height: int


def draw_figures(orders: list[FigureOrder], folder: Path, *, n_jobs: int = -1) -> list[FigureFile]:
    """Draw figures, several at a time, and write each as a PNG file into a folder."""
    folder.mkdir(exist_ok=True)
    files = list(in_processes(render, ((order,) for order in orders), n_jobs))
    for file in files:
        write_atomically(folder / f"{file.name}.png", partial(_write, content=file.png))
    return files


def render(order: FigureOrder) -> FigureFile:
    """Draw one figure."""
    figure = order.draw()
    figure.set_dpi(DPI)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())[..., :3]
    png = io.BytesIO()
    _with_few_colours(pixels).save(png, "PNG")
    width, height = (round(side * 96 / DPI) for side in pixels.shape[1::-1])
    return FigureFile(order.name, order.caption, png.getvalue(), width, height)


def _write(out: BinaryIO, content: bytes) -> None:
    out.write(content)


def _with_few_colours(pixels: NDArray[np.uint8]) -> Image.Image:
    """All the greys of a grey picture, 256 colours of another: a third of the page's size."""
    image = Image.fromarray(np.ascontiguousarray(pixels))
    red, blue = pixels[..., 0].astype(np.int16), pixels[..., 2].astype(np.int16)
    if np.abs(red - blue).max() <= GREY:
        return image.convert("L")
    return image.quantize(256, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
