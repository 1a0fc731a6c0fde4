"""The report as one HTML file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from servoscope.files import write_text
from servoscope.report.facts import collect_facts
from servoscope.report.figures.catalogue import list_figures
from servoscope.report.figures.rendering import draw_figures
from servoscope.report.run_data import read_run


def write_report(run: Path, *, n_jobs: int = -1) -> Path:
    """Write ``report.html`` and ``figures/`` into a run folder, from what it holds.

    Parameters
    ----------
    run : Path
        A finished run folder.
    n_jobs : int
        Processes that draw figures, as joblib counts them; all cores by default.

    Returns
    -------
    Path
        The report: one file that needs neither a network nor the rest of the folder.

    Raises
    ------
    RunFolderError
        If it is not a run folder, not finished, damaged, or was written by another version.
    """
    run = Path(run)
    data = read_run(run)
    files = draw_figures(list_figures(data), run / "figures", n_jobs=n_jobs)
    path = run / "report.html"
    write_text(path, render_page(collect_facts(data, files)))
    return path


def render_page(facts: dict[str, Any], template: str = "report.html") -> str:
    """The page that a template makes of facts; every value is escaped."""
    environment = Environment(
        loader=PackageLoader("servoscope.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template).render(facts)
