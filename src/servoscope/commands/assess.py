"""``servoscope assess``."""

from __future__ import annotations

from pathlib import Path

from servoscope.commands.options import DataSet, Force, Jobs, Json, Protocol, Resume, RunOut


def assess(
    dataset: DataSet,
    out: RunOut = Path("servoscope-run"),
    seed: int = 0,
    protocol: Protocol = "both",
    jobs: Jobs = None,
    resume: Resume = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Run the whole study on a data set folder, such as one made by acquire or by import.

    Example: servoscope assess desk --out desk-run

    Args:
        seed: Seed of the split and the nets.
    """
    from dataclasses import asdict

    from servoscope.commands.options import n_jobs, protocols
    from servoscope.commands.run_study import finish_run
    from servoscope.dataset import PoseImageSet
    from servoscope.errors import InvalidInputError
    from servoscope.study import StudyConfig, check_data
    from servoscope.study.run_folder import open_run_folder

    processes = n_jobs(jobs)
    config = StudyConfig(seed=seed, protocols=protocols(protocol))
    if out.resolve() in (dataset.resolve(), *dataset.resolve().parents):
        raise InvalidInputError(
            f"--out {out} is or holds the data set {dataset}; name another folder."
        )
    data = PoseImageSet.load(dataset)
    check_data(data, config)
    settings = {"command": "assess", **asdict(config), "dataset": str(dataset.resolve())}
    run = open_run_folder(out, settings, resume=resume, force=force)
    finish_run(run, data, config, processes, json=json)
