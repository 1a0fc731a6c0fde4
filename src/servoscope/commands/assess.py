"""``servoscope assess``."""

from __future__ import annotations

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
    Protocol,
    Resume,
    RunOut,
    with_dofs,
)
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

    Example: servoscope assess desk --tolerance t=1mm,rz=0.2deg --out desk-run

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
    import warnings
    from dataclasses import asdict

    from servoscope.commands.options import n_jobs, protocols
    from servoscope.commands.run_assessment import reported_pose_errors, run_assessment
    from servoscope.commands.run_study import finish_run, print_run
    from servoscope.data.checks import check_data
    from servoscope.data.images import PoseImageSet
    from servoscope.data.independence import check_enough_images, mark_sequence
    from servoscope.data.splits import MOST_IMAGES
    from servoscope.dofs import parse_dofs, parse_tolerances
    from servoscope.errors import InvalidInputError, ServoscopeWarning
    from servoscope.features.catalogue import parse_families
    from servoscope.poses import DOFS
    from servoscope.regression.registry import make_regressor
    from servoscope.storage.run_folder import owned_run_folder
    from servoscope.study import StudyConfig

    processes = n_jobs(jobs)
    config = StudyConfig(seed=seed, protocols=protocols(protocol))
    asked = DOFS if dofs is None else parse_dofs(dofs)
    tolerances, label_errors = (parse_tolerances(text, asked) for text in (tolerance, pose_error))
    tried = parse_families(families)
    make_regressor(regressor)
    if out.resolve() in (dataset.resolve(), *dataset.resolve().parents):
        raise InvalidInputError(
            f"--out {out} is or holds the data set {dataset}; name another folder."
        )
    data = with_dofs(PoseImageSet.load(dataset, memory=memory), dofs)
    check_enough_images(data)
    for finding in check_data(data):
        warnings.warn(finding.text, ServoscopeWarning, stacklevel=2)
    data = mark_sequence(data.thinned(MOST_IMAGES))  # the study's random split would flatter
    settings = {"command": "assess", **asdict(config), "dataset": str(dataset.resolve())}
    settings |= {"tolerance": tolerances, "pose_error": label_errors, "families": tried}
    settings |= {"regressor": regressor, "dofs": list(data.dofs), "study": study}
    with owned_run_folder(out, settings, resume=resume, force=force) as run:
        assessment = run_assessment(
            run,
            data,
            families=tried,
            regressor=regressor,
            seed=seed,
            tolerances=tolerances,
            label_errors=reported_pose_errors(data) | label_errors,
            compare=study,
            n_jobs=processes,
        )
        summary = finish_run(run, data, config, processes, assessment=assessment, study=study)
    print_run(summary, out, json=json)
