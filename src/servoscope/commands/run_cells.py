"""The part of ``study --cells`` that shares cells out, keeps what each gave, and reports."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from servoscope import __version__
from servoscope.commands.jobs import Failed, check_failed, outcomes
from servoscope.commands.output import console, print_json, progress_bar
from servoscope.errors import InvalidInputError, RunFolderError
from servoscope.storage.folders import write_json
from servoscope.storage.run_folder import VERSION, RunFolder, owned_run_folder, read_json
from servoscope.study.cells import (
    MOST_CELLS,
    Values,
    failed_cell,
    make_cells,
    study_cell,
    summarise_cells,
)
from servoscope.study.cells_page import (
    depends_table,
    describe_order,
    statements_table,
    write_cells_page,
)
from servoscope.study.paper import StudyConfig

CELLS_COMMAND = "study cells"
"""What the settings of such a run folder say that it was made by."""


def study_cells(
    out: Path,
    n_cells: int,
    n_images: int,
    image_size: int,
    config: StudyConfig,
    n_jobs: int,
    *,
    resume: bool,
    force: bool,
    json: bool,
) -> None:
    """Make the study in many cells, write the page of all, and print what was found.

    Raises
    ------
    RunFolderError
        In the end, if some could not be studied.
    """
    if not 1 <= n_cells <= MOST_CELLS:
        raise InvalidInputError(f"--cells must be from 1 to {MOST_CELLS}, got {n_cells}.")
    settings = {"command": CELLS_COMMAND, **asdict(config), "n_cells": n_cells}
    settings |= {"n_images": n_images, "image_size": image_size}
    with owned_run_folder(out, settings, resume=resume, force=force) as run:
        cells, failed = _cells(run, n_cells, n_images, image_size, config, n_jobs)
        found = summarise_cells(cells)
        seconds = round(sum(cell["seconds"] or 0.0 for cell in cells), 3)
        summary = {
            "version": VERSION,
            "servoscope": __version__,
            "settings": run.settings,
            "found": found,
            "cells": cells,
            "timings_s": {"total": seconds},
        }
        write_json(run.path / "summary.json", summary)
        write_cells_page(run.path / "report.html", summary)
    if json:
        print_json(summary)
    else:
        shown = console()
        shown.print(statements_table(found))
        shown.print(depends_table(found))
        shown.print(describe_order(found), soft_wrap=True)
        shown.print(f"report: {out / 'report.html'}", soft_wrap=True)
    what = f"{n_cells} cells could not be studied"
    check_failed(failed, what, out / "report.html", RunFolderError)


def write_cells_report(run: Path) -> Path:
    """Write the page of a finished run again."""
    summary = read_json(run / "summary.json")
    try:
        return write_cells_page(run / "report.html", summary)
    except (KeyError, TypeError, IndexError, AttributeError, ValueError) as error:
        raise RunFolderError(
            f"{run / 'summary.json'} is damaged; make the run again with --force."
        ) from error


def _cells(
    run: RunFolder,
    n_cells: int,
    n_images: int,
    image_size: int,
    config: StudyConfig,
    n_jobs: int,
) -> tuple[list[Values], dict[str, Failed]]:
    """What was found in each cell, and those that failed by name.

    Those that the folder has are not studied again.
    """
    folder = run.path / "cells"
    folder.mkdir(exist_ok=True)
    cells = make_cells(n_cells, config.seed)
    paths = [folder / f"{cell.number:04d}.json" for cell in cells]
    known = [_finished(path) for path in paths]
    left = [cell for cell in cells if known[cell.number] is None]
    failed = {}
    with progress_bar("cells", n_cells) as advance:
        advance(n_cells - len(left))
        calls = [(cell, n_images, image_size, config) for cell in left]
        made = outcomes(study_cell, calls, n_jobs)
        for n_done, (number, found) in enumerate(made, n_cells - len(left) + 1):
            cell = left[number]
            if isinstance(found, Failed):
                failed[cell.number] = found
            else:
                write_json(paths[cell.number], found)
                known[cell.number] = read_json(paths[cell.number])
            advance(n_done)
    rows = [
        failed_cell(cell, failed[cell.number].reason)
        if cell.number in failed
        else {**(known[cell.number] or {}), "error": None}
        for cell in cells
    ]
    return rows, {f"cell {number}": one for number, one in failed.items()}


def _finished(path: Path) -> Values | None:
    """What was found in a cell, if the folder has that whole."""
    try:
        found = read_json(path)
        float(found["seconds"])
        summarise_cells([{**found, "error": None}])
    except (RunFolderError, LookupError, TypeError, ValueError, AttributeError):
        return None
    return found
