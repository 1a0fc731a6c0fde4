"""Photometric servoing on a textured plane, beside what ViSP does on its own.

The conditions are those of a trial of ViSP 3.5.0 (`vpFeatureLuminance`, Levenberg-Marquardt law)
on a plane with a picture by Klimt: a pinhole 550 mm away, starts of up to 25 mm and 15 deg about
the point it looks at, exact calibration and depth, no noise, success = under 1 mm and under
0.1 deg. There images are 320 x 240, here 256 x 256 of the same area seen.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.scenery import PIVOT, RANGES
from benchmarks.tables import Findings
from servoscope.poses import inverse_transform, pose_error, poses_from_displacements
from servoscope.positioning.photometric import PhotometricEstimate, PhotometricServoing
from servoscope.processes import in_processes
from servoscope.scene.camera import Covering, Lens, Sensor
from servoscope.scene.render import render
from servoscope.scene.scene import T_WORLD_REF, Scene
from servoscope.scene.textured_plane import TexturedPlane

SIZE = 256
FAR_AWAY = 100.0
"""A start that has led farther than this is given up, [m]."""

LENS = Lens(
    focal_length=440 / np.sqrt(320 * 240), principal_point=(0.5, 0.5), distortion=(0.0, 0.0)
)
REFERENCE = Scene(TexturedPlane(), lens=LENS, image_size=SIZE)
NOISY = Sensor(full_well=1e6, read_noise=1e6 * 10 / 255)


@dataclass(frozen=True)
class Condition:
    """What differs from the reference, and what ViSP made of it.

    Parameters
    ----------
    name : str
    scene : Scene
    share : float
        Of the range of starts.
    depth : float
        The depth that is stated, relative to the true one.
    is_noisy : bool
        Whether the sensor draws noise.
    visp : str
        Success, median end and median moves.
    """

    name: str
    visp: str
    scene: Scene = REFERENCE
    share: float = 1.0
    depth: float = 1.0
    is_noisy: bool = False


CONDITIONS = (
    Condition("range x1.0", "19/20, 0.020 mm, 96"),
    Condition("range x1.5", "16/20, 0.015 mm, 141", share=1.5),
    Condition("gain 0.95", "9/10, 0.302 mm, 121", replace(REFERENCE, sensor=Sensor(gain=0.95))),
    Condition("gain 0.80", "0/20, 1.47 mm, -", replace(REFERENCE, sensor=Sensor(gain=0.80))),
    Condition(
        "10 % covered", "19/20, 0.418 mm, 98", replace(REFERENCE, covering=Covering(0.1, seed=0))
    ),
    Condition(
        "noise sigma 10", "19/20, 0.198 mm, 96", replace(REFERENCE, sensor=NOISY), is_noisy=True
    ),
    Condition("depth x0.6", "2/20, 71 mm, -", depth=0.6),
    Condition("depth x1.5", "1/20, 1239 mm, -", depth=1.5),
)


def tables(quick: bool) -> Iterator[Findings]:
    """One table."""
    n_starts, n_moves = (4, 120) if quick else (20, 300)
    conditions = CONDITIONS[::3] if quick else CONDITIONS
    calls = [(c, start, n_moves) for c in conditions for start in range(n_starts)]
    runs = np.array(list(in_processes(_run, calls))).reshape(len(conditions), n_starts, 3)
    rows = [_row(condition, run) for condition, run in zip(conditions, runs, strict=True)]
    yield Findings(
        "Photometric servoing",
        f"{n_starts} starts on a textured plane, at most {n_moves} moves; success, median of all "
        "ends, median of the moves until the first success",
        ("condition", "success", "end mm", "end deg", "moves", "ViSP"),
        rows,
    )


def _row(condition: Condition, runs: np.ndarray) -> tuple[str, ...]:
    ends_mm, ends_deg, moves = runs.T
    success = (ends_mm < 1) & (ends_deg < 0.1)
    known = moves[~np.isnan(moves)]
    return (
        condition.name,
        f"{success.sum()}/{len(runs)}",
        f"{np.median(ends_mm):.3g}",
        f"{np.median(ends_deg):.2g}",
        f"{np.median(known):.0f}" if len(known) else "-",
        condition.visp,
    )


def _run(condition: Condition, start: int, n_moves: int) -> tuple[float, float, float]:
    """How far from the reference a run ends, [mm] and [deg], and its moves to success."""
    servoing = _servoing(condition)
    rng = np.random.default_rng([7, start])
    delta_p = rng.uniform(-1, 1, (1, 6)) * condition.share * RANGES
    (pose,) = poses_from_displacements(T_WORLD_REF, delta_p, PIVOT)
    previous: PhotometricEstimate | None = None
    mm, deg, success = np.inf, np.inf, np.nan
    for moves in range(1, n_moves + 1):
        image = render(condition.scene, pose, rng if condition.is_noisy else None)
        previous = servoing.estimate(image, previous)
        pose = pose @ inverse_transform(previous.step)
        distance, angle = pose_error(T_WORLD_REF, pose)
        mm, deg = 1e3 * float(distance), float(np.degrees(angle))
        if np.isnan(success) and mm < 1 and deg < 0.1:
            success = moves
        if previous.converged or distance > FAR_AWAY:
            break
    return mm, deg, success


def _servoing(condition: Condition) -> PhotometricServoing:
    K = LENS.camera_matrix(SIZE)
    return PhotometricServoing(
        render(REFERENCE, T_WORLD_REF),
        K[0, 0],
        (K[0, 2], K[1, 2]),
        condition.depth * PIVOT,
        RANGES,
        PIVOT,
    )
