"""Many data sets assessed as one list of jobs: a run folder for each, and one page of all."""

from __future__ import annotations

import re
import shutil
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from servoscope import __version__
from servoscope.assessment.sets import (
    failed_row,
    row_of,
    sets_table,
    worst_first,
    write_sets_page,
)
from servoscope.commands.assessment_order import AssessmentOrder
from servoscope.commands.jobs import Failed, check_failed, outcomes
from servoscope.commands.output import console, print_json, progress_bar
from servoscope.commands.streams import reason_of
from servoscope.errors import DataSetError, RunFolderError, ServoscopeWarning
from servoscope.processes import in_processes, no_progress
from servoscope.storage.addresses import absolute
from servoscope.storage.folders import LOCK, scratch_folder, write_json
from servoscope.storage.run_folder import VERSION, RunFolder, owned_run_folder, read_json

Row = dict[str, Any]


@dataclass(frozen=True)
class Assessed:
    """What a process or a worker found of a data set, as values: it may share no folder with the
    one that asked.

    Parameters
    ----------
    row : dict
        Of `servoscope.assessment.sets`.
    files : dict
        The run folder, by the paths in it; empty where it failed.
    """

    row: Row
    files: dict[str, bytes]


def assess_sets(
    out: Path,
    order: AssessmentOrder,
    datasets: Sequence[str],
    n_jobs: int,
    *,
    resume: bool,
    force: bool,
    json: bool,
) -> None:
    """Assess data sets side by side, write the page of all, and print what was found.

    Raises
    ------
    DataSetError
        In the end, if some could not be assessed.
    """
    settings = {"command": SETS_COMMAND, **order.asked()}
    with owned_run_folder(out, settings, resume=resume, force=force) as run:
        apart = list(dict.fromkeys(map(absolute, datasets)))
        rows, failed = _rows(run, order, apart, n_jobs)
        seconds = sum(row["seconds"] or 0.0 for row in rows)
        summary = {
            "version": VERSION,
            "servoscope": __version__,
            "settings": run.settings,
            "n_failed": len(failed),
            "sets": rows,
            "timings_s": {"total": round(seconds, 3)},
        }
        write_json(run.path / "summary.json", summary)
        write_sets_page(run.path / "report.html", rows, run.settings)
    if json:
        print_json(summary)
    else:
        console().print(sets_table(rows))
        console().print(f"report: {out / 'report.html'}", soft_wrap=True)
    what = f"{len(rows)} data sets could not be assessed"
    check_failed(failed, what, out / "report.html", DataSetError)


SETS_COMMAND = "assess sets"
"""What the settings of such a run folder say that it was made by."""


def write_sets_report(run: Path) -> Path:
    """Write the page of a finished run of several data sets again."""
    summary = read_json(run / "summary.json")
    try:
        return write_sets_page(run / "report.html", summary["sets"], summary["settings"])
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise RunFolderError(
            f"{run / 'summary.json'} is damaged; make the run again with --force."
        ) from error


def _rows(
    run: RunFolder, order: AssessmentOrder, datasets: list[str], n_jobs: int
) -> tuple[list[Row], dict[str, Failed]]:
    """A row for each data set, the worst first, and those that failed by name.

    Those that the folder has finished are not assessed again, unless their images have changed.
    """
    names = _names(run, datasets)
    places = {dataset: run.path / "sets" / folder_of(names[dataset]) for dataset in datasets}
    (run.path / "sets").mkdir(exist_ok=True)
    rows = {dataset: _finished(places[dataset], dataset) for dataset in datasets}
    known = [(order, dataset, row["fingerprint"]) for dataset, row in rows.items() if row]
    for (_, dataset, _), is_same in zip(
        known, in_processes(compare_images, known, n_jobs), strict=True
    ):
        rows[dataset] = rows[dataset] if is_same else None
        if isinstance(is_same, str):
            warnings.warn(
                f"What was found before stays, but now: {is_same}", ServoscopeWarning, stacklevel=2
            )
    left = [dataset for dataset in datasets if rows[dataset] is None]
    failed = {}
    with progress_bar("data sets", len(datasets)) as advance:
        advance(len(datasets) - len(left))
        made = outcomes(assess_one, [(order, one) for one in left], n_jobs)
        for n_done, (number, found) in enumerate(made, len(datasets) - len(left) + 1):
            dataset = left[number]
            name, place = names[dataset], places[dataset]
            if isinstance(found, Failed):
                failed[name] = found
                found = Assessed(failed_row(found.reason), {})
            at = f"sets/{place.name}" if found.files else None
            row = {"name": name, "dataset": dataset, "run": at, **found.row}
            _put(place, found.files, row)
            rows[dataset] = row
            advance(n_done)
    return worst_first([row for row in rows.values() if row is not None]), failed


def assess_one(order: AssessmentOrder, dataset: str) -> Assessed:
    """What one process finds of one data set."""
    start = time.perf_counter()
    with (
        TemporaryDirectory(dir=scratch_folder(), ignore_cleanup_errors=True) as scratch,
        warnings.catch_warnings(record=True) as caught,
    ):
        warnings.simplefilter("always")
        folder = Path(scratch) / "run"
        data, findings = order.load(dataset)
        with owned_run_folder(folder, order.settings(dataset, data)) as run:
            summary = order.run(run, data, 1, no_progress)
        row = row_of(summary, [*findings, *_own(caught)])
        row["fingerprint"] = data.fingerprint()
        row["seconds"] = round(time.perf_counter() - start, 3)
        return Assessed(row, _files(folder))


def compare_images(order: AssessmentOrder, dataset: str, fingerprint: str) -> bool | str:
    """Whether the images of a data set are those that were assessed, or why it cannot be read."""
    try:
        return order.fingerprint(dataset) == fingerprint
    except DataSetError as error:
        return reason_of(error)


def _own(caught: Sequence[warnings.WarningMessage]) -> list[str]:
    """The warnings that are of servoscope."""
    own = (w for w in caught if issubclass(w.category, ServoscopeWarning))
    return list(dict.fromkeys(str(warning.message) for warning in own))


def _files(folder: Path) -> dict[str, bytes]:
    paths = [path for path in sorted(folder.rglob("*")) if path.is_file() and path.name != LOCK]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def _put(place: Path, files: dict[str, bytes], row: Row) -> None:
    """Put a run folder in its place as a whole; the row beside it says that it is there."""
    record, new = place.with_name(f"{place.name}.json"), place.with_name(f".{place.name}.part")
    record.unlink(missing_ok=True)
    for old in (place, new):
        shutil.rmtree(old, ignore_errors=True)
    for name, content in files.items():
        path = new / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    if files:
        new.rename(place)
    write_json(record, row)


def _finished(place: Path, dataset: str) -> Row | None:
    """The row of a data set that was assessed before; None if it was not, or failed."""
    try:
        row = read_json(place.with_name(f"{place.name}.json"))
    except RunFolderError:
        return None
    is_whole = row.get("dataset") == dataset and row.get("fingerprint") is not None
    return row if is_whole and (place / "report.html").exists() else None


def _names(run: RunFolder, datasets: Sequence[str]) -> dict[str, str]:
    """What each data set is called in a run folder, which keeps that: those that it has had before
    as they were, whether they are asked for again or not.
    """
    path = run.path / "sets.json"
    before = read_json(path) if path.exists() else {}
    folders = {folder_of(name) for name in before.values() if isinstance(name, str)}
    if len(folders) < len(before):
        raise RunFolderError(f"{path} is damaged; make the run again with --force.")
    names = names_of(datasets, before)
    write_json(path, names)
    return names


def names_of(datasets: Sequence[str], before: Mapping[str, str] | None = None) -> dict[str, str]:
    """What each data set is called: the shortest end of its path that is the folder of no other.

    Parameters
    ----------
    datasets : sequence of str
    before : dict, optional
        Names that stay as they are.

    Returns
    -------
    dict
        Those of before as well.

    Examples
    --------
    >>> names_of(["/a/monday", "/b/monday", "s3://parts/7"])["/b/monday"]
    'b/monday'
    >>> names_of(["/b/monday"], {"/a/monday": "monday"})
    {'/a/monday': 'monday', '/b/monday': 'b/monday'}
    """
    names = dict(before or {})
    parts = {
        dataset: [part for part in re.split(r"[/\\]+", dataset) if part]
        for dataset in [*names, *datasets]
    }
    taken = {folder_of(name) for name in names.values()}
    for dataset in datasets:
        if dataset in names:
            continue
        others = [words for one, words in parts.items() if one != dataset]
        name = _shortest(parts[dataset], others, taken)
        whole, number = name, 2
        while folder_of(name) in taken:
            name, number = f"{whole}-{number}", number + 1
        names[dataset] = name
        taken.add(folder_of(name))
    return names


def _shortest(words: list[str], others: list[list[str]], taken: set[str]) -> str:
    """The shortest end of a path whose folder is not taken, nor that of as long an end of another;
    if there is none, the whole.
    """
    for length in range(1, len(words) + 1):
        name = "/".join(words[-length:])
        ends = {folder_of("/".join(other[-length:])) for other in others}
        if folder_of(name) not in ends | taken:
            return name
    return "/".join(words) or "set"


def folder_of(name: str) -> str:
    """The folder of a name, which any file system takes."""
    return re.sub(r"[^\w-]+", "_", name).strip("_").lower() or "set"
