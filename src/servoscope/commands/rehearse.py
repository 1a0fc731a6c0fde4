"""``servoscope rehearse``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from servoscope.commands.options import Force, Jobs, Json, Model, Resume, RunOut

if TYPE_CHECKING:
    from servoscope.rehearsal import Rehearsal
    from servoscope.storage.run_folder import RunFolder


def rehearse(
    model: Model,
    out: RunOut = Path("servoscope-rehearsal"),
    starts: int = 20,
    conditions: tuple[str, ...] = (),
    range_mm: float | None = None,
    range_deg: float | None = None,
    seed: int = 0,
    jobs: Jobs = None,
    resume: Resume = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Try a model out on images of its own view, before the robot moves.

    The loop is run from many starts on images that are rendered of the model's keyframe: wider and
    narrower ranges, another gain, a moved lamp, a covered view, noise, defocus, a robot that
    scatters, images that come late. It says what would arrive and where not; the images are as
    far from the model as those were that training held out.

    Example: servoscope rehearse model --starts 40 --conditions range_1.0 covered_20

    Example: servoscope import tum sequence data && servoscope train data --out model && servoscope
    rehearse model --range-mm 50 --range-deg 5

    Args:
        starts: Starts under each condition.
        conditions: Names of what is different; by default all that images can show: range_0.4,
            range_1.0, range_1.5, gain_0.8, gain_0.95, light_moved, covered_10, covered_20,
            noise_10, defocus, repeatability, stale_frames, light_falloff.
        range_mm: Largest displacement of a start along each axis at range 1.0; by default that
            which the images were taken in.
        range_deg: The same about each axis, about the pivot.
        seed: Seed of the starts, of what is different, and of the noise.
    """
    from hashlib import sha256

    from servoscope.commands.options import n_jobs
    from servoscope.commands.output import print_json
    from servoscope.positioning.model import PositioningModel
    from servoscope.rehearsal.page import write_rehearsal
    from servoscope.rehearsal.run import REHEARSED, Rehearsal, as_keyframe_model, check_conditions
    from servoscope.storage.run_folder import owned_run_folder

    processes = n_jobs(jobs)
    names = check_conditions(conditions) or REHEARSED
    trained = as_keyframe_model(PositioningModel.load(model), str(model))
    rehearsal = Rehearsal(trained, starts, seed, range_mm, range_deg)
    settings = {
        "command": "rehearse",
        "model": str(model),
        "model_sha256": sha256((model / "model.json").read_bytes()).hexdigest(),
        "starts": starts,
        "seed": seed,
        "range_mm": range_mm,
        "range_deg": range_deg,
        "conditions": list(names),
    }
    with owned_run_folder(out, settings, resume=resume, force=force) as run:
        results = _results(run, rehearsal, names, processes)
        images = {name: rehearsal.first_image(name) for name in names}
        page = write_rehearsal(run.path, results, {"reference": trained.reference_image, **images})
    if json:
        print_json(results)
    else:
        _print_rehearsal(results, out / page.name)


def _results(
    run: RunFolder, rehearsal: Rehearsal, names: tuple[str, ...], processes: int
) -> dict[str, Any]:
    """Go through the conditions that are not finished, and write ``rehearsal.json``."""
    from functools import partial

    from servoscope import __version__
    from servoscope.commands.output import progress_bar
    from servoscope.rehearsal.run import verdict
    from servoscope.storage.folders import write_json
    from servoscope.storage.run_folder import read_json

    inputs = {"settings": run.settings, "servoscope": __version__}
    results = {}
    for name in names:
        path = run.path / "trials" / f"{name}.json"
        rehearsed = partial(rehearsal.run, name, n_jobs=processes, progress=progress_bar)
        write = partial(_write_starts, path, rehearsed)
        run.run_stage(f"starts_{name}", inputs, write, [f"trials/{path.name}"])
        results[name] = read_json(path)
    facts = {
        "version": 1,
        "servoscope": __version__,
        "model": run.settings["model"],
        "starts": rehearsal.starts,
        "seed": rehearsal.seed,
        "ranges": rehearsal.described_ranges(),
        "verdict": verdict(results),
        "results": results,
        "timings_s": run.timings(),
    }
    write_json(run.path / "rehearsal.json", facts)
    return facts


def _write_starts(path: Path, rehearsed: Any) -> None:
    from servoscope.storage.folders import write_json

    found = rehearsed()
    path.parent.mkdir(exist_ok=True)
    write_json(path, found)


def _print_rehearsal(results: dict[str, Any], page: Path) -> None:
    from servoscope.commands.output import console
    from servoscope.rehearsal.page import LEGEND, rehearsal_table

    out = console()
    out.print(rehearsal_table(results))
    out.print(LEGEND)
    out.print(results["verdict"])
    out.print(f"total {results['timings_s']['total']:.1f} s")
    out.print(f"page: {page}", soft_wrap=True)
