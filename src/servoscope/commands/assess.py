"""``servoscope assess``."""

from __future__ import annotations

from pathlib import Path

from servoscope.commands.options import DataSet, Force, Jobs, Json, Protocol, Resume, RunOut


def assess(
    dataset: DataSet,
    out: RunOut = Path("servoscope-run"),
    want: str = "",
    pose_error: str = "",
    families: str = "all",
    seed: int = 0,
    protocol: Protocol = "both",
    jobs: Jobs = None,
    resume: Resume = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Say what each degree of freedom will reach, what limits it and what would help.

    Works on a data set folder, such as one made by acquire or by import, of 60 images or more.
    Of enough images the paper's study is made as well.

    Example: servoscope assess desk --want t=1mm,rz=0.2deg --out desk-run

    Args:
        want: Wished RMS errors, such as tx=0.5mm,rz=0.1deg; t and r stand for all three of a kind.
        pose_error: RMS errors of the poses that the robot tells, written like --want. Known of
            simulated images; taken for 0 otherwise.
        families: Families of features to try, with commas between them, of moments, eigenfeatures,
            pose_covariance, least_squares, projections, log_polar, gradient, intensity, robust.
        seed: Seed of the split and the nets.
    """
    import warnings
    from dataclasses import asdict

    from servoscope.assessment import parse_wishes
    from servoscope.assessment.families import choose_tried
    from servoscope.commands.options import n_jobs, protocols
    from servoscope.commands.run_assessment import run_assessment, told_label_errors
    from servoscope.commands.run_study import finish_run, print_run
    from servoscope.data.checks import check_data
    from servoscope.data.images import PoseImageSet
    from servoscope.data.independence import check_enough_images, mark_sequence
    from servoscope.errors import InvalidInputError, ServoscopeWarning
    from servoscope.study import StudyConfig
    from servoscope.study.run_folder import owned_run_folder

    processes = n_jobs(jobs)
    config = StudyConfig(seed=seed, protocols=protocols(protocol))
    wishes, label_errors = parse_wishes(want), parse_wishes(pose_error)
    tried = choose_tried(families)
    if out.resolve() in (dataset.resolve(), *dataset.resolve().parents):
        raise InvalidInputError(
            f"--out {out} is or holds the data set {dataset}; name another folder."
        )
    data = PoseImageSet.load(dataset)
    check_enough_images(data)
    for finding in check_data(data):
        warnings.warn(finding.text, ServoscopeWarning, stacklevel=2)
    data = mark_sequence(data)  # the study's random split would flatter
    settings = {"command": "assess", **asdict(config), "dataset": str(dataset.resolve())}
    settings |= {"want": wishes, "pose_error": label_errors, "families": tried}
    with owned_run_folder(out, settings, resume=resume, force=force) as run:
        assessment = run_assessment(
            run,
            data,
            families=tried,
            seed=seed,
            wishes=wishes,
            label_errors=told_label_errors(data) | label_errors,
            n_jobs=processes,
        )
        summary = finish_run(run, data, config, processes, assessment=assessment)
    print_run(summary, out, json=json)
