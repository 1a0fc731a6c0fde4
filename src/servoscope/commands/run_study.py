"""The part that ``study`` and ``assess`` share: the study of a data set, and its report."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

from servoscope.commands.output import console, print_json, progress_bar
from servoscope.commands.run_assessment import print_assessment, study_sample
from servoscope.data.images import PoseImageSet
from servoscope.errors import InvalidInputError
from servoscope.processes import ProgressBar
from servoscope.storage.folders import write_json
from servoscope.storage.run_folder import RunFolder, read_json
from servoscope.study import Study, StudyConfig
from servoscope.study.agreement import compare_order_of_families
from servoscope.study.criteria import compare_criteria
from servoscope.study.page import write_report
from servoscope.study.results import list_units
from servoscope.study.run import describe_run
from servoscope.study.tables import errors_table


def finish_run(
    run: RunFolder,
    data: PoseImageSet,
    config: StudyConfig,
    n_jobs: int,
    *,
    assessment: dict[str, Any] | None = None,
    study: bool = True,
    progress: ProgressBar = progress_bar,
) -> dict[str, Any]:
    """Go through what is not finished of a run and write its report; returns its summary.

    With an assessment, the study is left out unless it is asked for and these images do for it.
    """
    path = run.path / "summary.json"
    try:
        if not study:
            raise InvalidInputError("It is made with --study.")
        data, split = study_sample(run, data, assessment)
        whole = Study(run, data, config, split=split, n_jobs=n_jobs, progress=progress)
        whole.run()
        summary = read_json(path)
        if assessment is not None:
            summary["criteria"] = compare_criteria(whole)
    except InvalidInputError as error:
        if assessment is None:
            raise
        summary = describe_run(run, data) | {"protocols": {}, "study_left_out": str(error)}
    if assessment is not None:
        summary = {"assessment": assessment["dofs"], **summary, "assessed": assessment}
    write_json(path, summary)
    with progress("report", 1) as advance:
        write = partial(write_report, run.path, n_jobs=n_jobs)
        shown = {name: summary.get(name) for name in ("protocols", "assessed", "criteria")}
        run.run_stage("report", shown, write, ["report.html"])
        advance(1)
    summary["timings_s"] = run.timings()
    write_json(path, summary)
    return summary


def print_run(summary: dict[str, Any], run: Path, *, json: bool) -> None:
    """Print what was assessed, or else the errors by family and dof, and where the report is."""
    if json:
        print_json(summary)
        return
    out = console()
    if "assessed" in summary:
        print_assessment(summary["assessed"])
        if "study_left_out" in summary and summary["settings"].get("study"):
            out.print(f"The paper's study is left out. {summary['study_left_out']}")
    else:
        _print_study(summary)
    out.print(f"total {summary['timings_s']['total']:.1f} s")
    out.print(f"report: {run / 'report.html'}", soft_wrap=True)


def _print_study(summary: dict[str, Any]) -> None:
    out = console()
    for unit in list_units(summary):
        out.print(unit.title)
        out.print(errors_table(unit, is_brief=True))
    for finding in compare_order_of_families(summary):
        out.print(f"The paper: {finding.claim} Here: {finding.verdict}.")
