"""``servoscope sensitivity``."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from servoscope.commands.options import Force, Jobs, Json, Part, Resume, RunOut

if TYPE_CHECKING:
    from servoscope.dataset import PoseImageSet
    from servoscope.sensitivity import SensitivityConfig
    from servoscope.study.run_folder import RunFolder


def sensitivity(
    out: RunOut = Path("servoscope-sensitivity"),
    n_images: int = 400,
    n_test: int = 60,
    image_size: int = 128,
    seed: int = 0,
    part: Part = "cylinder_head",
    features: tuple[str, ...] = (),
    disturbances: tuple[str, ...] = (),
    regressor: str = "gaussian_process",
    jobs: Jobs = None,
    resume: Resume = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Tell how the error grows once camera, light or robot are not as they were in training.

    Models of three families of features are trained on simulated images and then, without
    training again, given images with one thing disturbed: focal length, principal point,
    distortion, gain, noise, defocus, a lamp's place, the robot's repeatability, the camera's
    mount. Beside what comes out stands what derivatives predict.

    Example: servoscope sensitivity --out sensitivity

    Args:
        n_images: Images that train.
        n_test: Poses at which images are taken anew with everything disturbed in turn.
        image_size: Height and width of the images, in pixels.
        seed: Seed of the poses, the noise and the disturbances.
        features: Families of features: moments, eigenfeatures, tchebichef, intensity, robust; the
            first three by default.
        disturbances: Names, as in the table, of what is disturbed; by default all.
        regressor: What tells each dof: gaussian_process, kernel_ridge, levenberg_marquardt (the
            paper's nets), bayesian_lm, lbfgs.
    """
    from dataclasses import asdict

    from servoscope.commands.options import n_jobs
    from servoscope.commands.output import print_json
    from servoscope.report.sensitivity import write_sensitivity
    from servoscope.sensitivity import DISTURBANCES, SensitivityConfig
    from servoscope.sensitivity.config import DEFAULT_FEATURES
    from servoscope.study.run_folder import owned_run_folder

    processes = n_jobs(jobs)
    config = SensitivityConfig(
        n_images=n_images,
        n_test=n_test,
        image_size=image_size,
        seed=seed,
        part=part,
        features=features or DEFAULT_FEATURES,
        disturbances=disturbances or tuple(DISTURBANCES),
        regressor=regressor,
    )
    settings = {"command": "sensitivity", **asdict(config)}
    with owned_run_folder(out, settings, resume=resume, force=force) as run:
        results = _results(run, config, processes)
        figures = write_sensitivity(run.path, results, n_jobs=processes)
    if json:
        print_json(results)
    else:
        _print_tables(results, [out / figure.relative_to(run.path) for figure in figures])


def _results(run: RunFolder, config: SensitivityConfig, processes: int) -> dict[str, Any]:
    """Go through the stages that are not finished, and write ``sensitivity.json``."""
    from dataclasses import asdict
    from functools import partial

    from servoscope import __version__
    from servoscope.commands.progress import progress_bar
    from servoscope.files import write_json
    from servoscope.sensitivity import SensitivityRun
    from servoscope.study.run_folder import read_json

    inputs = {"config": asdict(config), "servoscope": __version__}
    analysis = SensitivityRun(
        _images(run, config, inputs, processes), config, n_jobs=processes, progress=progress_bar
    )
    errors = {}
    for name in config.disturbances:
        path = run.path / "trials" / f"{name}.json"
        write = partial(_write_errors, path, partial(analysis.measure, name))
        run.run_stage(f"errors_{name}", inputs, write, [f"trials/{path.name}"])
        errors[name] = read_json(path)
    results = {
        "version": 1,
        "servoscope": __version__,
        "settings": run.settings,
        "ranges": analysis.ranges(),
        "features": {
            features: {"sensitivity": {name: errors[name][features] for name in errors}}
            for features in config.features
        },
        "timings_s": run.timings(),
    }
    write_json(run.path / "sensitivity.json", results)
    return results


def _images(
    run: RunFolder, config: SensitivityConfig, inputs: dict[str, Any], processes: int
) -> PoseImageSet:
    from servoscope.acquisition import acquire
    from servoscope.commands.progress import progress_bar
    from servoscope.dataset import PoseImageSet

    folder, acquisition = run.path / "dataset", config.acquisition()

    def take() -> None:
        with progress_bar("images", acquisition.total()) as advance:
            acquire(folder, acquisition, n_jobs=processes, on_progress=advance)

    run.run_stage("images", inputs, take, ["dataset/meta.json", "dataset/images.zarr"])
    return PoseImageSet.load(folder)


def _write_errors(path: Path, measure: Callable[[], dict[str, Any]]) -> None:
    from servoscope.files import write_json

    errors = measure()
    path.parent.mkdir(exist_ok=True)
    write_json(path, errors)


def _print_tables(results: dict[str, Any], figures: list[Path]) -> None:
    from rich.table import Table

    from servoscope.commands.output import console
    from servoscope.sensitivity.table import COLUMNS, TITLES, clean_row, table_rows

    out = console()
    for name, of_features in results["features"].items():
        table = Table(title=f"{name}: {TITLES['doubles_at'].lower()}", title_justify="left")
        for column in COLUMNS:
            table.add_column(column, justify="left" if column in COLUMNS[:2] else "right")
        table.add_row(*clean_row(of_features["sensitivity"]), end_section=True)
        for row in table_rows(of_features["sensitivity"], "doubles_at"):
            table.add_row(*row)
        out.print(table)
    out.print(f"total {results['timings_s']['total']:.1f} s")
    for figure in figures:
        out.print(f"figure: {figure}", soft_wrap=True)
