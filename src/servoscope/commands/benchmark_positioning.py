"""``servoscope benchmark positioning``."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from servoscope.commands.options import Force, Jobs, Json, Resume, RunOut


def benchmark_positioning(
    out: RunOut = Path("servoscope-scoreboard"),
    quick: bool = False,
    starts: int | None = None,
    image_size: int = 256,
    seed: int = 0,
    jobs: Jobs = None,
    resume: Resume = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Compare ways of bringing a camera back, from the same starts in the same images.

    On two simulated scenes and under many conditions: servoscope, the paper's networks alone, and
    photometric servoing that is given the camera's calibration and all depths. Takes about half an
    hour on two cores, or two and a half minutes with --quick.

    Example: servoscope benchmark positioning --quick --seed 7

    Args:
        quick: Fewer images, conditions and starts.
        starts: Starts under each condition; by default 100, or 10 with --quick. Photometric
            servoing has fewer where its many images are dear.
        image_size: Height and width of the images, in pixels.
        seed: Seed of the starts, the images, the noise and the nets.
    """
    from dataclasses import asdict

    from servoscope.commands.options import n_jobs
    from servoscope.commands.output import print_json, progress_bar
    from servoscope.scoreboard.cell import SCENES
    from servoscope.scoreboard.page import write_scoreboard
    from servoscope.scoreboard.plan import Plan
    from servoscope.scoreboard.run import Scoreboard
    from servoscope.storage.run_folder import owned_run_folder

    processes = n_jobs(jobs)
    plan = Plan(quick=quick, seed=seed, starts=starts, image_size=image_size)
    settings = {"command": "benchmark positioning", **asdict(plan)}
    with owned_run_folder(out, settings, resume=resume, force=force) as folder:
        board = Scoreboard(folder, plan, n_jobs=processes, progress=progress_bar)
        scoreboard = board.run()
        trials = {scene: board.trials(scene) for scene in SCENES}
        page = write_scoreboard(folder.path, scoreboard, trials)
    if json:
        print_json(scoreboard)
    else:
        _print_scoreboard(scoreboard, out / page.name)


def _print_scoreboard(scoreboard: dict[str, Any], page: Path) -> None:
    from servoscope.commands.output import console
    from servoscope.scoreboard.page import LEGEND, scoreboard_table, target_text

    out = console()
    for scene in scoreboard["results"]:
        out.print(scoreboard_table(scoreboard, scene))
    out.print(LEGEND)
    for target in scoreboard["targets"]:
        out.print(target_text(target))
    out.print(f"total {scoreboard['timings_s']['total']:.1f} s")
    out.print(f"page: {page}", soft_wrap=True)


def benchmark_commands() -> dict[str, Callable[..., None]]:
    """The benchmarks, by name."""
    return {"positioning": benchmark_positioning}
