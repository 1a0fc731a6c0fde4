"""A rehearsal as a page, as figures and as a table for documents."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from servoscope.files import write_text
from servoscope.rehearsal.summary import COLUMNS, ENOUGH, LEGEND, as_markdown, table_rows
from servoscope.report.facts import describe_figure
from servoscope.report.figures.captions import Caption
from servoscope.report.figures.rehearsal import draw_examples, draw_starts, draw_success
from servoscope.report.figures.rendering import FigureOrder, draw_figures
from servoscope.report.html import render_page

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


def write_rehearsal(
    folder: Path, rehearsal: Mapping[str, Any], images: Mapping[str, NDArray[np.uint8]]
) -> Path:
    """Write ``rehearsal.html``, ``rehearsal.md`` and ``figures/``.

    Parameters
    ----------
    folder : Path
    rehearsal : dict
        As in ``rehearsal.json``.
    images : dict
        One by its name for each condition.

    Returns
    -------
    Path
        The page: one file that needs neither a network nor the rest of the folder.
    """
    results = rehearsal["results"]
    shown = {name: _thumbnail(image) for name, image in images.items()}
    orders = [
        FigureOrder("success", SUCCESS, partial(draw_success, results, ENOUGH)),
        FigureOrder("starts", STARTS, partial(draw_starts, results)),
        FigureOrder("examples", EXAMPLES, partial(draw_examples, shown)),
    ]
    figures = draw_figures(orders, folder / "figures", n_jobs=1)
    write_text(folder / "rehearsal.md", as_markdown(results))
    facts = {
        "rehearsal": rehearsal,
        "columns": COLUMNS,
        "legend": LEGEND,
        "rows": table_rows(results),
        "ranges": range_text(rehearsal["ranges"]),
        "figures": [describe_figure(figure) for figure in figures],
    }
    path = folder / "rehearsal.html"
    write_text(path, render_page(facts, "rehearsal.html"))
    return path


def range_text(ranges: Mapping[str, Mapping[str, Any]]) -> str:
    """Largest displacements of a start, such as ``tx 25 mm, rz 15 deg``."""
    return ", ".join(f"{dof} {of['value']:.3g} {of['unit']}" for dof, of in ranges.items())


def _thumbnail(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    scale = min(1.0, _THUMBNAIL / image.shape[1])
    size = (round(scale * image.shape[1]), round(scale * image.shape[0]))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
