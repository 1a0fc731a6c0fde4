"""The part of ``assess`` that decides: what each dof will reach, and what would help."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.text import Text

from servoscope.assessment import as_json, assess
from servoscope.assessment.page import reach_table
from servoscope.commands.output import console
from servoscope.data.folder import writing
from servoscope.data.images import PoseImageSet
from servoscope.data.splits import Split
from servoscope.errors import InvalidInputError, ServoscopeWarning
from servoscope.pipeline import PosePipeline
from servoscope.poses import DISPLAY_UNITS, DOFS
from servoscope.processes import ProgressBar
from servoscope.storage.folders import write_json
from servoscope.storage.run_folder import RunFolder, read_json

Errors = Mapping[str, float]


def run_assessment(
    run: RunFolder,
    data: PoseImageSet,
    *,
    families: Sequence[str],
    regressor: str,
    seed: int,
    compare: bool,
    tolerances: Errors,
    label_errors: Errors,
    n_jobs: int,
    progress: ProgressBar,
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
            progress=progress,
        )
        if found.pipeline is not None:
            _save(found.pipeline, models, data, found.independence.labels[: len(data)])
        if found.sample.n_rendered:
            with writing(run.path / "dataset", replace=True) as place:
                found.data.save(place)
        write_json(path, as_json(found, tolerances, label_errors))

    inputs = {"data": data.fingerprint(), "settings": run.settings}
    run.run_stage("decision", inputs, make, [path.name])
    return read_json(path)


def study_sample(
    run: RunFolder, data: PoseImageSet, assessment: Mapping[str, Any] | None
) -> tuple[PoseImageSet, Split | None]:
    """The images of a study: those of the assessment, and its split, where some are rendered."""
    images = {} if assessment is None else assessment["images"]
    if not images.get("n_rendered"):
        return data, None
    parts = (np.array(images["split"][f.name], dtype=np.intp) for f in fields(Split))
    return PoseImageSet.load(run.path / "dataset"), Split(*parts)


def _save(
    pipeline: PosePipeline, models: Path, data: PoseImageSet, groups: NDArray[np.intp]
) -> None:
    """Save the pipeline of the choice with the data that it is of, unless it cannot be saved."""
    pipeline.record_ |= {"fingerprint": data.fingerprint(), "groups": groups.tolist()}
    models.mkdir(exist_ok=True)
    try:
        pipeline.save(models / "pipeline", force=True)
    except InvalidInputError as error:
        warnings.warn(f"The pipeline is not saved. {error}", ServoscopeWarning, stacklevel=3)


def reported_pose_errors(data: PoseImageSet) -> dict[str, float]:
    """Errors of the poses that a simulated robot reports, [mm] and [deg]; nothing of a real one."""
    known = {unit: data.source.get(f"repeatability_{unit}") for unit in ("mm", "deg")}
    return {
        dof: float(error)
        for dof, unit in zip(DOFS, DISPLAY_UNITS, strict=True)
        if isinstance(error := known[unit], int | float)
    }


def print_assessment(assessment: dict[str, Any]) -> None:
    """Print the verdict, what each dof reaches and what the view allows, and what would help."""
    out = console()
    out.print(Text(assessment["conclusion"], style="bold"), soft_wrap=True)
    out.print(reach_table(assessment))
    for dof, row in assessment["dofs"].items():
        for line in row["advice"]:
            out.print(Text(f"{dof}: {line}"), soft_wrap=True)
    for warning in assessment["warnings"]:
        out.print(Text(warning), soft_wrap=True)
