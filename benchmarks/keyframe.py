"""Keyframes of few images: one look at images that were kept out, simulated and real.

``python -m benchmarks keyframe``. Real data are read where they lie beside the project (see
`real_images`); their tables are left out otherwise. Times are those of the processor, on one
thread.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks import real_images
from benchmarks.real_images import (
    TUM_DELAY,
    evenly,
    read_kitchen,
    read_kuka,
    read_tum_sequence,
    split_by_blocks,
)
from benchmarks.tables import Findings
from servoscope import (
    AcquisitionConfig,
    CameraModel,
    Keyframe,
    acquire,
)
from servoscope.poses import (
    DISPLAY_FACTORS,
    displacements_from_poses,
    inverse_transform,
    poses_from_displacements,
)
from servoscope.robots.arm import MOUNT
from servoscope.scene.cylinder_head import CylinderHead
from servoscope.scene.render import render
from servoscope.scene.scene import T_WORLD_REF, Scene
from servoscope.scene.textured_plane import TexturedPlane
from servoscope.scoreboard.cell import CONDITIONS

PIVOT = 0.55
RANGES = np.array([0.025] * 3 + [np.radians(15)] * 3)
DOFS = ("tx mm", "ty mm", "tz mm", "rx deg", "ry deg", "rz deg")
HEADER = ("what", "arrive", *DOFS, "within 2 sd")
NEAR_MM, NEAR_DEG = 5.0, 2.0
GUESS = 0.2
"""Largest error of a first guess in each dof, in shares of the range."""

CELLS = {
    "cylinder head": ("cylinder_head", "free", CylinderHead(), np.eye(4)),
    "textured plane": ("textured_plane", "free", TexturedPlane(), np.eye(4)),
    "head on the arm": ("cylinder_head", "arm", CylinderHead(), MOUNT),
}
DISTURBED = ("gain_0.8", "light_moved", "noise_10", "defocus", "covered_10", "covered_20")


@dataclass(frozen=True, eq=False)
class Images:
    """Images with the displacements that they were taken at, as reported."""

    images: np.ndarray
    displacements: np.ndarray


def tables(quick: bool) -> Iterator[Findings]:
    """Tables of the simulated cell and of the real data at hand."""
    with threadpool_limits(1):
        yield from _simulated(quick)
        yield from _real(quick)


def _real(quick: bool) -> Iterator[Findings]:
    if (real_images.SHARED / "kuka_board").exists():
        yield _kuka(quick)
    if (real_images.SHARED / "tum_fr1_rpy").exists():
        for delay in (0.0, TUM_DELAY):
            title = f"TUM fr1/rpy, hand-held, poses {1e3 * delay:g} ms earlier"
            yield _sequence(title, *read_tum_sequence(delay), gap=0.3, quick=quick)
    if (real_images.SHARED / "seven_scenes_kitchen").exists():
        yield _sequence("7-Scenes red kitchen, hand-held", *read_kitchen(), gap=10, quick=quick)


def _simulated(quick: bool) -> Iterator[Findings]:
    n_held_out = 8 if quick else 40
    few, disturbed, limits, seconds = [], [], [], []
    for name, (part, robot, shape, mount) in list(CELLS.items())[: 1 if quick else 3]:
        with tempfile.TemporaryDirectory() as folder:
            config = AcquisitionConfig(schedule=((90, 1.6),), part=part, robot=robot)
            data = acquire(Path(folder) / "data", config, n_jobs=1)
        scene = Scene(part=shape)
        rng = np.random.default_rng(5)
        delta_p = rng.uniform(-1, 1, (n_held_out, 6)) * RANGES
        T_cam = poses_from_displacements(T_WORLD_REF, delta_p, PIVOT)
        T_ref = data.T_world_ref @ mount
        true = mount @ inverse_transform(T_ref) @ T_cam @ inverse_transform(mount)
        views = {"range_1.0": scene} | {c: CONDITIONS[c] for c in DISTURBED}
        held_out = {condition: Images(_taken(scene, T_cam, condition), true) for condition in views}
        keyframes = {}
        for n in (20,) if quick else (12, 20, 40):
            for draw in range(1 if quick else 2):
                chosen = np.random.default_rng(draw).permutation(90)[:n]
                start = time.process_time()
                keyframe = Keyframe.fit(
                    data.images[chosen],
                    data.T_world_cam[chosen],
                    data.reference_image,
                    data.T_world_ref,
                    pivot=data.pivot,
                    pose_noise=(1e-4, 2e-4),
                )
                seconds.append((f"{name}, {n} images", time.process_time() - start))
                keyframes[n, draw] = keyframe
                row = _row(f"{name}, {n} images, draw {draw}", keyframe, held_out["range_1.0"])
                few.append(row)
        keyframe = keyframes[20, 0]
        for condition, images in held_out.items():
            disturbed.append(_row(f"{name}, {condition}, no guess", keyframe, images))
            guesses = _guesses(images.displacements, keyframe.pivot)
            disturbed.append(_row(f"{name}, {condition}, guess", keyframe, images, guesses))
        limits.extend(_limit_rows(name, keyframe, scene, mount))
        seconds.append((f"{name}, a look from a guess", _look_seconds(keyframe, images, guesses)))
        seconds.append((f"{name}, a look from none", _look_seconds(keyframe, images)))
    far = f"arrive = within {NEAR_MM:g} mm and {NEAR_DEG:g} deg; median errors about the pivot"
    yield Findings(
        "Keyframes of few images",
        "simulated cell, 256 px, images drawn from 1.6 of the range; one look, without a first "
        f"guess, at {n_held_out} others drawn from the range; {far}",
        HEADER,
        few,
    )
    yield Findings(
        "Keyframes under the scoreboard's conditions",
        f"20 images; one look from none or from a first guess off by up to {GUESS:g} of the range "
        f"in every dof; {far}",
        HEADER,
        disturbed,
    )
    yield Findings(
        "Looks at the reference and the limit of the view",
        "60 looks with the sensor's noise; standard deviations",
        ("what", *DOFS),
        limits,
    )
    rows = [(what, f"{value:.3g}") for what, value in seconds]
    yield Findings("Times", "CPU seconds of one thread", ("what", "s"), rows)


def _taken(scene: Scene, T_world_cam: np.ndarray, condition: str) -> np.ndarray:
    change = CONDITIONS[condition].change
    return np.stack(
        [
            render(change(scene, k), T, np.random.default_rng([3, k]))
            for k, T in enumerate(T_world_cam)
        ]
    )


def _guesses(displacements: np.ndarray, pivot: float) -> np.ndarray:
    rng = np.random.default_rng(11)
    off = rng.uniform(-GUESS, GUESS, (len(displacements), 6)) * RANGES
    delta_p = displacements_from_poses(np.eye(4), displacements, pivot) + off
    return poses_from_displacements(np.eye(4), delta_p, pivot)


def _row(
    what: str, keyframe: Keyframe, held_out: Images, guesses: np.ndarray | None = None
) -> tuple[str, ...]:
    true = displacements_from_poses(np.eye(4), held_out.displacements, keyframe.pivot)
    starts = [None] * len(true) if guesses is None else guesses
    found = [keyframe.align(i, s) for i, s in zip(held_out.images, starts, strict=True)]
    off = np.array([f.delta_p for f in found]) - true
    sure = np.abs(off) < 2 * np.array([f.std for f in found])
    shown = np.abs(off) * DISPLAY_FACTORS
    mm, deg = (np.linalg.norm(part, axis=1) for part in np.split(shown, 2, axis=1))
    arrived = (mm < NEAR_MM) & (deg < NEAR_DEG)
    medians = [f"{value:.2g}" for value in np.median(shown, axis=0)]
    share = f"{sure[arrived].mean():.2f}" if arrived.any() else "-"
    return (what, f"{arrived.sum()}/{len(true)}", *medians, share)


def _limit_rows(
    name: str, keyframe: Keyframe, scene: Scene, mount: np.ndarray
) -> Iterator[tuple[str, ...]]:
    rng = np.random.default_rng(17)
    clean = render(scene, T_WORLD_REF).astype(float)
    looks = [render(scene, T_WORLD_REF, rng) for _ in range(60)]
    noise = float(np.sqrt(np.mean([np.mean((look - clean) ** 2) for look in looks])))
    found = [keyframe.align(look, np.eye(4)) for look in looks]
    bound = keyframe.limit(noise).std
    scatter = np.std([f.delta_p for f in found], axis=0, ddof=1)
    believed = np.median([f.std for f in found], axis=0)
    for what, values in (
        ("Cramer-Rao bound", bound * DISPLAY_FACTORS),
        ("scatter", scatter * DISPLAY_FACTORS),
        ("believed", believed * DISPLAY_FACTORS),
        ("scatter / bound", scatter / bound),
    ):
        yield (f"{name}: {what}", *(f"{value:.2g}" for value in values))


def _look_seconds(keyframe: Keyframe, held_out: Images, guesses: np.ndarray | None = None) -> float:
    start = time.process_time()
    for k, image in enumerate(held_out.images):
        keyframe.align(image, None if guesses is None else guesses[k])
    return (time.process_time() - start) / len(held_out.images)


def _kuka(quick: bool) -> Findings:
    images, poses = read_kuka()
    reference, others = 13, [k for k in range(28) if k != 13]
    lens = CameraModel(0.550, -0.001, -0.007, -0.13, 0.10)
    rows = []
    for camera, known in ((None, "nothing known"), (lens, "intrinsics given")):
        for draw in range(1 if quick else 6):
            order = np.random.default_rng(draw).permutation(others)
            train, test = order[:20], order[20:]
            start = time.process_time()
            keyframe = Keyframe.fit(
                images[train], poses[train], images[reference], poses[reference],
                pivot=0.0, camera=camera, pose_noise=(4e-4, 1e-3),
            )  # fmt: skip
            seconds = time.process_time() - start
            true = inverse_transform(poses[reference]) @ poses[test]
            row = _row(
                f"{known}, draw {draw}, {seconds:.1f} s", keyframe, Images(images[test], true)
            )
            rows.append(row)
    return Findings(
        "A real arm's wrist camera",
        "kuka_board: 20 images to fit, 7 others to read in one look, without a first guess; "
        "displacements of the tool itself",
        HEADER,
        rows,
    )


def _sequence(
    title: str,
    held: tuple[np.ndarray, np.ndarray, np.ndarray],
    reference: tuple[np.ndarray, np.ndarray],
    camera: CameraModel | None,
    gap: float,
    quick: bool,
) -> Findings:
    images, poses, times = held
    rows = []
    for given in (camera, None) if camera else (None,):
        for draw in range(1 if quick else 3):
            train, test = split_by_blocks(times, gap, draw)
            train, test = evenly(train, 80), evenly(test, 40)
            start = time.process_time()
            keyframe = Keyframe.fit(
                images[train], poses[train], *reference,
                pivot=0.0, distance=1.0, camera=given, pose_noise=(2e-3, 3e-3),
            )  # fmt: skip
            seconds = time.process_time() - start
            true = inverse_transform(reference[1]) @ poses[test]
            known = "intrinsics given" if given else "nothing known"
            row = _row(
                f"{known}, draw {draw}, {seconds:.1f} s", keyframe, Images(images[test], true)
            )
            rows.append(row)
    return Findings(
        title,
        "80 frames to fit; 40 frames of blocks of time that were kept out, with a gap before and "
        "after them, read in one look without a first guess; displacements of the camera itself",
        HEADER,
        rows,
    )
