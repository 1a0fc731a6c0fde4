"""The sensitivity analysis as figures and as tables for documents."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

from servoscope.files import write_text
from servoscope.report.figures.captions import Caption
from servoscope.report.figures.rendering import FigureOrder, draw_figures
from servoscope.report.figures.sensitivity import draw_sensitivity
from servoscope.sensitivity.table import as_markdown

CAPTION = Caption(
    "Sensitivity",
    "RMS error of each degree of freedom against the strength of each disturbance: solid in images "
    "taken anew, dashed to first order.",
    "Charts of RMS errors against strength, one for each disturbance, with a solid and a dashed "
    "line for each degree of freedom.",
)


def write_sensitivity(folder: Path, results: dict[str, Any], *, n_jobs: int = -1) -> list[Path]:
    """Write ``sensitivity.md`` and ``figures/sensitivity_{features}.png``.

    Parameters
    ----------
    folder : Path
    results : dict
        As in ``sensitivity.json``.
    n_jobs : int

    Returns
    -------
    list of Path
        The figures.
    """
    write_text(folder / "sensitivity.md", as_markdown(results["features"]))
    orders = [
        FigureOrder(
            f"sensitivity_{name}",
            CAPTION,
            partial(draw_sensitivity, of_features["sensitivity"], results["ranges"]),
        )
        for name, of_features in results["features"].items()
    ]
    figures = draw_figures(orders, folder / "figures", n_jobs=n_jobs)
    return [folder / "figures" / f"{figure.name}.png" for figure in figures]
