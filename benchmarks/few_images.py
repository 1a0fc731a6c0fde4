"""Starts of the scoreboard with models of few images.

``python -m benchmarks few_images``. A keyframe model is trained on the images of one acquisition
within 1.6 of the range, as `servoscope train` does it, and brought back from the scoreboard's
starts under its conditions, in the same loop.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.tables import Findings
from servoscope import AcquisitionConfig, acquire
from servoscope.positioning import KeyframeModel, train
from servoscope.processes import in_processes, one_blas_thread
from servoscope.scoreboard.cell import CONDITIONS, robot_at_reference, robot_in_cell
from servoscope.scoreboard.methods import loop_settings
from servoscope.scoreboard.trial import SUCCESS_DEG, SUCCESS_MM, Trial, run_trial

CELLS = (("cylinder_head", "free"), ("textured_plane", "free"), ("cylinder_head", "arm"))
TITLES = ("cylinder head", "textured plane", "cylinder head, crooked camera on the arm")
MEASURED = (
    "range_1.0",
    "range_1.5",
    "gain_0.8",
    "light_moved",
    "light_falloff",
    "covered_10",
    "covered_20",
    "noise_10",
    "defocus",
    "other_casting",
    "repeatability",
    "stale_frames",
)
SIZE, SEED, BLOCK = 256, 0, 10


def tables(quick: bool) -> Iterator[Findings]:
    """Successes of every cell, number of images and condition."""
    n_starts, numbers = (5, (40,)) if quick else (100, (40, 20))
    for (part, robot), title in list(zip(CELLS, TITLES, strict=True))[: 1 if quick else 3]:
        for n_images in numbers:
            starts = n_starts if n_images == numbers[0] else n_starts // 2
            model = trained(part, robot, n_images)
            rows = []
            for condition in MEASURED:
                calls = [
                    (model, part, robot, condition, range(k, min(k + BLOCK, starts)))
                    for k in range(0, starts, BLOCK)
                ]
                trials = [trial for block in in_processes(_trials, calls, -1) for trial in block]
                rows.append(_row(condition, trials))
                print(title, n_images, *rows[-1], file=sys.stderr, flush=True)
            yield Findings(
                f"Keyframe of {n_images} images: {title}",
                f"{starts} starts; success under {SUCCESS_MM:g} mm and {SUCCESS_DEG:g} deg; one "
                "acquisition, seed 0",
                (
                    "condition",
                    "success",
                    "moves",
                    "median end",
                    "converged, limited, other",
                    "falsely converged",
                    "within 2 sd",
                    "decision ms",
                ),
                rows,
            )


def trained(part: str, robot: str, n_images: int) -> KeyframeModel:
    config = AcquisitionConfig(
        schedule=((n_images, 1.6),), part=part, robot=robot, image_size=SIZE, seed=SEED
    )
    with tempfile.TemporaryDirectory() as folder:
        model = train(acquire(Path(folder) / "data", config))
    assert isinstance(model, KeyframeModel)
    return model


def _trials(
    model: KeyframeModel, part: str, robot: str, condition: str, starts: range
) -> list[Trial]:
    settings = loop_settings("ours", CONDITIONS[condition].repeatability)
    reference = robot_at_reference(part, robot, SIZE)
    with one_blas_thread():
        return [
            run_trial(
                robot_in_cell(part, 0, robot, condition, SIZE, SEED, start),
                reference,
                model,
                settings,
            )
            for start in starts
        ]


def _row(condition: str, trials: list[Trial]) -> tuple[str, ...]:
    good = [trial.succeeded for trial in trials]
    statuses = [trial.status for trial in trials]
    ended = [trial for trial in trials if trial.status in ("converged", "limited")]
    n = {name: statuses.count(name) for name in ("converged", "limited")}
    false = sum(t.status == "converged" and not t.succeeded for t in trials)
    off = [np.subtract(t.truth, t.believed) / np.array(t.std, dtype=float) for t in ended]
    inside = f"{np.mean(np.abs(off) < 2):.2f}" if off else "-"
    return (
        f"`{condition}`",
        f"{sum(good)}/{len(trials)}",
        f"{np.median([t.moves for t in trials]):g}",
        f"{np.median([t.end_mm for t in trials]):.3f} mm, "
        f"{np.median([t.end_deg for t in trials]):.4f} deg",
        f"{n['converged']}, {n['limited']}, {len(trials) - sum(n.values())}",
        str(false),
        inside,
        f"{np.median([ms for t in trials for ms in t.decisions_ms]):.0f}",
    )
