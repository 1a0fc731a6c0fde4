"""What a rehearsal forecasts, against what happens in the simulated cell.

``python -m benchmarks rehearsal``. A keyframe model is trained on 20 images and rehearsed: it sees
nothing but images that are rendered of its own reference view. Then the loop is run in the
simulated cell itself, from the same starts, under the same conditions.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from benchmarks.tables import Findings
from servoscope import AcquisitionConfig, acquire
from servoscope.positioning import train
from servoscope.processes import one_blas_thread
from servoscope.rehearsal import Rehearsal
from servoscope.rehearsal.run import summarise_rehearsal
from servoscope.scoreboard.cell import CONDITIONS, SCENES, robot_at_reference, robot_in_cell
from servoscope.scoreboard.methods import loop_settings
from servoscope.scoreboard.page import TITLES
from servoscope.scoreboard.trial import run_trial

N_IMAGES, N_STARTS, SEED = 20, 20, 0
POINTS = 5
"""How far a forecast may be off, [percentage points]."""

REHEARSED = (
    "range_1.0",
    "range_1.5",
    "gain_0.8",
    "light_moved",
    "covered_10",
    "covered_20",
    "noise_10",
    "defocus",
    "repeatability",
    "stale_frames",
    "light_falloff",
)
HEADER = (
    "condition",
    "forecast",
    "true",
    "points off",
    "forecast end",
    "true end",
    "wrongly converged, forecast and true",
)


def tables(quick: bool) -> Iterator[Findings]:
    """Forecast and truth of every scene and condition."""
    n_starts, conditions = (3, ("range_1.0", "covered_20")) if quick else (N_STARTS, REHEARSED)
    scenes = SCENES[1:] if quick else SCENES
    off: list[float] = []
    for scene in scenes:
        rows = []
        model = _trained(scene)
        rehearsal = Rehearsal(model, n_starts, SEED)
        for condition in conditions:
            forecast = rehearsal.run(condition, n_jobs=1)
            true = _in_the_cell(model, scene, condition, n_starts)
            points = 100 * (forecast["success"] - true["success"]) / n_starts
            off.append(abs(points))
            rows.append(_row(condition, forecast, true, points))
            print(scene, *rows[-1], file=sys.stderr, flush=True)
        within = sum(points <= POINTS for points in off)
        yield Findings(
            f"Forecast by rehearsal against the simulated cell: {TITLES[scene].lower()}",
            f"{N_IMAGES} images of 256 px within 1.6 of the range; {n_starts} starts under each "
            f"condition, the same ones; so far {within} of {len(off)} within {POINTS} points",
            HEADER,
            rows,
        )


def _trained(scene: str) -> Any:
    with tempfile.TemporaryDirectory() as folder:
        config = AcquisitionConfig(schedule=((N_IMAGES, 1.6),), part=scene, seed=SEED)
        return train(acquire(Path(folder) / "data", config, n_jobs=1), method="keyframe")


def _in_the_cell(model: Any, scene: str, condition: str, n_starts: int) -> dict[str, Any]:
    """What becomes of starts in the simulated cell."""
    reference = robot_at_reference(scene, "free", 256)
    settings = loop_settings("ours", CONDITIONS[condition].repeatability)
    with one_blas_thread():
        cells = (robot_in_cell(scene, 0, "free", condition, 256, SEED, k) for k in range(n_starts))
        trials = [run_trial(cell, reference, model, settings) for cell in cells]
    return summarise_rehearsal(trials)


def _row(
    name: str, forecast: dict[str, Any], true: dict[str, Any], points: float
) -> tuple[str, ...]:
    counts = [f"{found['success']}/{found['trials']}" for found in (forecast, true)]
    ends = [
        f"{found['final_mm_median']:.2g} mm, {found['final_deg_median']:.2g} deg"
        for found in (forecast, true)
    ]
    wrong = f"{forecast['wrongly_converged']}, {true['wrongly_converged']}"
    return (name, *counts, f"{points:+.0f}", *ends, wrong)
