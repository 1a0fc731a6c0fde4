"""The tables of a finished run, of whatever command."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from servoscope.errors import RunFolderError

if TYPE_CHECKING:
    from servoscope.report.table import Table


def tables_of(run: Path) -> list[Table]:
    """All tables of a run.

    Raises
    ------
    RunFolderError
        If it is not finished, damaged, or has no tables.
    """
    from servoscope.storage.run_folder import read_json, read_settings

    read_settings(run)
    makers = {"rehearsal": _rehearsed, "scoreboard": _compared, "sensitivity": _disturbed}
    for name, make in makers.items():
        file = run / f"{name}.json"
        if file.exists():
            found = read_json(file)
            try:
                return make(found)
            except (AttributeError, LookupError, TypeError, ValueError) as error:
                raise RunFolderError(f"{file} is damaged; repeat the run.") from error
    return _studied(run)


def _rehearsed(rehearsal: dict[str, Any]) -> list[Table]:
    from servoscope.rehearsal.page import rehearsal_table

    return [rehearsal_table(rehearsal)]


def _compared(scoreboard: dict[str, Any]) -> list[Table]:
    from servoscope.scoreboard.page import scoreboard_table

    return [scoreboard_table(scoreboard, scene) for scene in scoreboard["results"]]


def _disturbed(results: dict[str, Any]) -> list[Table]:
    from servoscope.sensitivity.page import TITLES, sensitivity_table

    return [
        sensitivity_table(name, one["sensitivity"], key)
        for name, one in results["features"].items()
        for key in TITLES
    ]


def _studied(run: Path) -> list[Table]:
    from servoscope.assessment.page import disturbed_table, families_table, reach_table
    from servoscope.study.results import read_run
    from servoscope.study.tables import study_tables

    data = read_run(run)
    tables = []
    if data.assessed:
        tables += [f(data.assessed) for f in (reach_table, families_table, disturbed_table)]
    n_bins = data.settings.get("n_bins")
    for unit in data.units:
        of_unit = study_tables(unit, n_bins)
        tables += [replace(table, title=f"{table.title}. {unit.title}") for table in of_unit]
    return tables
