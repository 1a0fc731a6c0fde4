"""``servoscope assess``."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from servoscope.commands.options import (
    DataSet,
    Dofs,
    Force,
    Jobs,
    Json,
    Memory,
    MoreDataSets,
    Protocol,
    Resume,
    RunOut,
)
from servoscope.errors import InvalidInputError, ServoscopeWarning
from servoscope.storage.sizes import DEFAULT_MEMORY

Tolerance = Annotated[
    str,
    arg(
        aliases=["--want"],
        help="RMS errors that are asked for, such as tx=0.5mm,rz=0.1deg; t and r stand for all "
        "three of a kind.",
    ),
]


def assess(
    dataset: DataSet,
    more: MoreDataSets = (),
    out: RunOut = Path("servoscope-run"),
    tolerance: Tolerance = "",
    pose_error: str = "",
    families: str = "all",
    regressor: str = "gaussian_process",
    dofs: Dofs = None,
    study: bool = False,
    seed: int = 0,
    protocol: Protocol = "both",
    jobs: Jobs = None,
    memory: Memory = DEFAULT_MEMORY,
    resume: Resume = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Say what each degree of freedom will reach, what limits it and what would help.

    Works on a data set folder, such as one made by acquire or by import, of 60 images or more. From
    20 on, images rendered by a keyframe join them, if one explains the view.
    The features and regressors that are chosen are trained and saved in the run's
    models/pipeline.

    Several data sets are assessed side by side, each by one process or worker: a run folder for
    each in OUT/sets, and one page of all, the worst first. One that cannot be assessed is a line
    with its reason, and the command fails in the end.

    Example: servoscope assess desk --tolerance t=1mm,rz=0.2deg --out desk-run

    Example: servoscope assess desk shelf bench --tolerance t=1mm --workers 4 --out night

    Args:
        pose_error: RMS errors of the poses that the robot reports, written like --tolerance. Known
            of simulated images; taken for 0 otherwise.
        families: Families of features to try, with commas between them, of moments, eigenfeatures,
            pose_covariance, least_squares, projections, log_polar, gradient, intensity, robust,
            tchebichef, lfa, and those of installed packages; all stands for these but tchebichef
            and lfa.
        regressor: What is trained on the chosen features: gaussian_process, kernel_ridge,
            levenberg_marquardt (the paper's nets), bayesian_lm, lbfgs, or one of an installed
            package.
        study: Make the paper's study of these images as well, of 144 or more or with those
            rendered, and compare regressors.
        seed: Seed of the split and the nets.
    """
    from servoscope.commands.assessment_order import AssessmentOrder
    from servoscope.commands.options import n_jobs, protocols
    from servoscope.commands.output import progress_bar
    from servoscope.commands.run_sets import assess_sets
    from servoscope.commands.run_study import print_run
    from servoscope.dofs import parse_dofs, parse_tolerances
    from servoscope.features.catalogue import parse_families
    from servoscope.poses import DOFS
    from servoscope.regression.registry import make_regressor
    from servoscope.storage.run_folder import owned_run_folder
    from servoscope.study import StudyConfig

    processes = n_jobs(jobs)
    asked = DOFS if dofs is None else parse_dofs(dofs)
    make_regressor(regressor)
    order = AssessmentOrder(
        StudyConfig(seed=seed, protocols=protocols(protocol)),
        families=tuple(parse_families(families)),
        regressor=regressor,
        dofs=dofs,
        tolerances=parse_tolerances(tolerance, asked),
        pose_errors=parse_tolerances(pose_error, asked),
        study=study,
        memory=memory,
    )
    for one in (dataset, *more):
        check_apart(out, one)
    if more:
        assess_sets(out, order, (dataset, *more), processes, resume=resume, force=force, json=json)
        return
    data, findings = order.load(dataset)
    for finding in findings:
        warnings.warn(finding, ServoscopeWarning, stacklevel=2)
    with owned_run_folder(out, order.settings(dataset, data), resume=resume, force=force) as run:
        summary = order.run(run, data, processes, progress_bar)
    print_run(summary, out, json=json)


def check_apart(out: Path, dataset: str) -> None:
    """Raise InvalidInputError if a run folder would be, or hold, a data set."""
    from servoscope.storage.addresses import place_of

    place = place_of(dataset)
    if isinstance(place, str):
        return
    place = place.resolve()
    if out.resolve() in (place, *place.parents):
        raise InvalidInputError(
            f"--out {out} is or holds the data set {dataset}; name another folder."
        )
