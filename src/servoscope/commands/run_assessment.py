"""The part of ``assess`` that decides: what each dof will reach, and what would help."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from servoscope.assessment import as_json, assess
from servoscope.commands.output import console
from servoscope.commands.progress import progress_bar
from servoscope.data.images import PoseImageSet
from servoscope.errors import InvalidInputError, ServoscopeWarning
from servoscope.files import write_json
from servoscope.pipeline import PosePipeline
from servoscope.poses import DISPLAY_UNITS, DOFS
from servoscope.study.run import fingerprint
from servoscope.study.run_folder import RunFolder, read_json

Errors = Mapping[str, float]


def run_assessment(
    run: RunFolder,
    data: PoseImageSet,
    *,
    families: Sequence[str],
    regressor: str,
    seed: int,
    compare: bool,
    wishes: Errors,
    label_errors: Errors,
    n_jobs: int,
) -> dict[str, Any]:
    """Assess a data set, unless the run folder holds the assessment already."""
    path, models = run.path / "assessment.json", run.path / "models"

    def make() -> None:
        found = assess(
            data,
            families=families,
            regressor=regressor,
            seed=seed,
            compare=compare,
            n_jobs=n_jobs,
            progress=progress_bar,
        )
        if found.pipeline is not None:
            _save(found.pipeline, models, data, found.independence.labels)
        write_json(path, as_json(found, wishes, label_errors))

    inputs = {"data": fingerprint(data), "settings": run.settings}
    run.run_stage("decision", inputs, make, [path.name])
    return read_json(path)


def _save(
    pipeline: PosePipeline, models: Path, data: PoseImageSet, groups: NDArray[np.intp]
) -> None:
    """Save the pipeline of the choice with the data that it is of, unless it cannot be saved."""
    pipeline.record_ |= {"fingerprint": fingerprint(data), "groups": groups.tolist()}
    models.mkdir(exist_ok=True)
    try:
        pipeline.save(models / "pipeline", force=True)
    except InvalidInputError as error:
        warnings.warn(f"The pipeline is not saved. {error}", ServoscopeWarning, stacklevel=3)


def told_label_errors(data: PoseImageSet) -> dict[str, float]:
    """Errors of the poses that a simulated robot tells, [mm] and [deg]; nothing of a real one."""
    told = {unit: data.source.get(f"repeatability_{unit}") for unit in ("mm", "deg")}
    return {
        dof: float(error)
        for dof, unit in zip(DOFS, DISPLAY_UNITS, strict=True)
        if isinstance(error := told[unit], int | float)
    }


def print_assessment(assessment: dict[str, Any]) -> None:
    """Print what each dof reaches, what limits it, and what would help it most."""
    out = console()
    table = Table(title="What each degree of freedom will reach", title_justify="left")
    for heading in ("dof", "forecast (90 %)", "reached", "wanted", "told", "limited by"):
        table.add_column(heading)
    table.add_column("what would help most")
    for dof, row in assessment["dofs"].items():
        advice = row["advice"][0] if row["advice"] else "-"
        table.add_row(dof, *_numbers(row), row["told"], row["limited_by"], advice)
    out.print(table)
    out.print(assessment["conclusion"])
    for warning in assessment["warnings"]:
        out.print(warning)


def _numbers(row: dict[str, Any]) -> tuple[str, str, str]:
    """Forecast, reached and wanted; a dash for what there is not."""
    unit = row["unit"]
    wanted = "-" if row["wanted"] is None else f"{row['wanted']:.3g} {unit}"
    if row["forecast_rms"] is None:
        return "-", "-", wanted
    low, high = row["interval"]
    forecast = f"{row['forecast_rms']:.2g} {unit} ({low:.2g} to {high:.2g})"
    return forecast, f"{row['reached_rms']:.2g} {unit}", wanted
