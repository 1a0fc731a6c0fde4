"""``servoscope study`` and ``servoscope report``."""

from __future__ import annotations

from pathlib import Path

from servoscope.commands.options import Force, Jobs, Json, Protocol, Resume, Run, RunOut


def study(
    out: RunOut = Path("servoscope-study"),
    n_images: int = 1000,
    image_size: int | None = None,
    cells: int | None = None,
    seed: int = 0,
    protocol: Protocol = "both",
    jobs: Jobs = None,
    resume: Resume = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Take images of the simulated part, assess every feature, train the nets, write the report.

    This is the study of Wells and Torras (2001), end to end: Tables I to III and the counterparts
    of its figures, beside the published numbers.

    With --cells N it is made in N simulated cells of other parts, lights, lenses and sensors, which
    processes or workers share: in what share of them each statement of the paper holds, and what
    the order of the families depends on.

    Example: servoscope study --n-images 400 --image-size 128 --out quick

    Example: servoscope study --cells 20 --out cells

    Args:
        n_images: Number of images, of each cell.
        image_size: Height and width of the images, in pixels; 256 by default, 64 with --cells.
        cells: Number of cells to make a lighter study in, with one trial a net and 7 thresholds.
        seed: Seed of the poses, the noise, the split and the nets; with --cells of all that
            differs between cells.
    """
    from dataclasses import asdict
    from functools import partial

    from servoscope.acquisition import AcquisitionConfig, acquire
    from servoscope.commands.options import n_jobs, protocols
    from servoscope.commands.output import progress_bar
    from servoscope.data.images import PoseImageSet
    from servoscope.storage.run_folder import RunFolder, owned_run_folder
    from servoscope.study.paper import StudyConfig, check_n_images

    processes = n_jobs(jobs)
    config = StudyConfig(seed=seed, protocols=protocols(protocol))
    check_n_images(n_images, config.protocols)
    if cells is not None:
        from servoscope.commands.run_cells import study_cells
        from servoscope.study.cells import IMAGE_SIZE, lighter

        size = IMAGE_SIZE if image_size is None else image_size
        AcquisitionConfig(n_images=n_images, image_size=size, seed=seed)  # refused before a folder
        options = {"resume": resume, "force": force, "json": json}
        study_cells(out, cells, n_images, size, lighter(config), processes, **options)
        return
    size = 256 if image_size is None else image_size
    acquisition = AcquisitionConfig(n_images=n_images, image_size=size, seed=seed)
    settings = {"command": "study", **asdict(config), "acquisition": asdict(acquisition)}

    def take_images(run: RunFolder) -> None:
        with progress_bar("images", n_images) as advance:
            acquire(run.path / "dataset", acquisition, n_jobs=processes, on_progress=advance)

    made = ["dataset/meta.json", "dataset/images.zarr"]
    with owned_run_folder(out, settings, resume=resume, force=force) as run:
        run.run_stage("acquire", settings["acquisition"], partial(take_images, run), made)
        from servoscope.commands.run_study import finish_run, print_run  # not waited for before

        data = PoseImageSet.load(run.path / "dataset")
        summary = finish_run(run, data, config, processes)
    print_run(summary, out, json=json)


def report(run: Run, svg: bool = False, jobs: Jobs = None, json: Json = False) -> None:
    """Write the report of a finished run again.

    Example: servoscope report servoscope-study

    Example: servoscope report servoscope-study --svg

    Args:
        svg: Write each figure as SVG too, for print.
    """
    from functools import partial

    from servoscope.commands.options import n_jobs
    from servoscope.commands.output import print_facts
    from servoscope.commands.run_cells import CELLS_COMMAND, write_cells_report
    from servoscope.commands.run_sets import SETS_COMMAND, write_sets_report
    from servoscope.storage.folders import owned
    from servoscope.storage.run_folder import read_settings
    from servoscope.study.page import write_report

    processes = n_jobs(jobs)
    made_by = read_settings(run).get("command")  # no lock where there is no run
    write = {SETS_COMMAND: write_sets_report, CELLS_COMMAND: write_cells_report}.get(
        str(made_by), partial(write_report, n_jobs=processes, svg=svg)
    )
    with owned(run):
        page = write(run)
    print_facts({"report": str(page)}, as_json=json)
