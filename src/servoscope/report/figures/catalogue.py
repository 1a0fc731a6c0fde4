"""Which figures a run has, what stands under each, and how they become files."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from servoscope.files import write_atomically
from servoscope.poses import DOFS
from servoscope.report.figures import overview, pictures, selection, sweep
from servoscope.report.figures.captions import CAPTIONS, Caption
from servoscope.report.run_data import RunData, Unit
from servoscope.study.paper import TABLE3

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


def list_figures(run: RunData) -> list[FigureOrder]:
    """All figures of a run; those of a unit are named ``{protocol}_{displacement}_...``."""
    image = run.features["reference_image"]
    first = run.units[0].results
    orders = [
        FigureOrder("reference", CAPTIONS["reference"], partial(pictures.draw_reference, image)),
        FigureOrder("slices", CAPTIONS["slices"], partial(pictures.draw_slices, image)),
        FigureOrder(
            "overview", CAPTIONS["overview"], partial(overview.draw_overview, image, first)
        ),
    ]
    for unit in run.units:
        orders += _of_unit(run, unit)
    return orders


def draw_figures(orders: list[FigureOrder], folder: Path, *, n_jobs: int = -1) -> list[FigureFile]:
    """Draw figures, several at a time, and write each as a PNG file into a folder."""
    folder.mkdir(exist_ok=True)
    files = Parallel(n_jobs=n_jobs)(delayed(render)(order) for order in orders)
    for file in files:
        write_atomically(folder / f"{file.name}.png", lambda out, png=file.png: out.write(png))
    return files


def render(order: FigureOrder) -> FigureFile:
    """Draw one figure; 256 colours, which keeps the page small."""
    figure = order.draw()
    figure.set_dpi(DPI)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    image = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    png = io.BytesIO()
    image.quantize(256, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE).save(png, "PNG")
    width, height = (round(side * 96 / DPI) for side in image.size)
    return FigureFile(order.name, order.caption, png.getvalue(), width, height)


def _of_unit(run: RunData, unit: Unit) -> list[FigureOrder]:
    shown = run.pictures[unit.key]
    draw: dict[str, Callable[[], Figure]] = {
        "eigenvectors": partial(pictures.draw_eigenvectors, shown["eigenvectors"]),
        "pci": partial(pictures.draw_signed, shown["pci"], "pci_"),
        "covariance": partial(pictures.draw_signed, shown["covariance"]),
        "filtered": partial(pictures.draw_locations, shown["filtered"], shown["locations"]),
        "lfa": partial(pictures.draw_signed, shown["lfa"]),
        "best": _best_features(run, unit),
        "plane": _planes(run, unit),
        "sweep": partial(
            sweep.draw_sweeps,
            unit.results["sweep"],
            unit.results["ranges"],
            {dof: float(TABLE3[dof]["rms"]) for dof in DOFS},
            decided_on_test=unit.protocol == "paper",
        ),
    }
    return [
        FigureOrder(f"{unit.key}_{kind}", CAPTIONS[kind], drawing) for kind, drawing in draw.items()
    ]


def _best_features(run: RunData, unit: Unit) -> Callable[[], Figure]:
    columns = {str(name): i for i, name in enumerate(run.features["names"])}
    first = {dof: unit.results["ranking"][dof][0]["feature"] for dof in DOFS}
    table = run.features[unit.key]
    values = {dof: table[:, columns[name]] for dof, name in first.items()}
    delta_p = run.features[f"delta_p_{unit.displacement}"]
    return partial(selection.draw_best_features, values, first, delta_p)


def _planes(run: RunData, unit: Unit) -> Callable[[], Figure]:
    information = unit.results["mi"]
    names = list(information)
    relevance = {dof: np.array([information[name][dof] for name in names]) for dof in DOFS}
    steps = {dof: run.selection[f"{unit.key}_{dof}"] for dof in DOFS}
    redundancy = {dof: table[min(selection.STEP, len(table)) - 1] for dof, table in steps.items()}
    return partial(selection.draw_selection_planes, relevance, redundancy, names)
