"""Real closed loops on recorded frames, and images that do not show the part.

``python -m benchmarks recorded``. The real sequences are read where they lie beside the project
(see `real_images`); without them only simulated parts are tried.
"""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks import real_images
from benchmarks.real_images import evenly, read_kitchen, read_kuka, read_tum_sequence
from benchmarks.tables import Findings
from servoscope import AcquisitionConfig, LoopSettings, PoseImageSet, Positioner, acquire
from servoscope.positioning import KeyframeModel
from servoscope.positioning.guard import novelty_fault
from servoscope.robots.recorded import RecordedRobot

SEQUENCES = {
    "tum_fr1_rpy": ("TUM fr1/rpy", 0.3),
    "seven_scenes_kitchen": ("7-Scenes red kitchen", 10.0),
}
N_STARTS = 20
N_FOREIGN = 60
SIMULATED = {"head": "cylinder_head", "plane": "textured_plane"}
FOREIGN = ("turned by 60", "turned by 180", *SIMULATED, "TUM", "kitchen", "board")


def tables(quick: bool) -> Iterator[Findings]:
    """The loops, and what is refused."""
    with threadpool_limits(1):
        at_hand = [name for name in SEQUENCES if (real_images.SHARED / name).exists()]
        loops, models = [], {}
        for name in at_hand:
            for draw in range(1 if quick else 3):
                learned, live = _parts(name, draw)
                model = KeyframeModel.train(learned)
                title = f"{SEQUENCES[name][0]}, draw {draw}"
                loops.extend(_loops(title, model, live, draw))
                models.setdefault(SEQUENCES[name][0], (model, live))
        yield Findings(
            "Real closed loops on recorded frames",
            "models of nine of twelve blocks of time; the robot lives on the others, goes to the "
            "nearest frame (a degree counts as 10 mm), and begins at frames within the range of "
            "training; within = ends at the reference or at the frame next to it; falsely = "
            "converged elsewhere",
            (
                "sequence",
                "frames",
                "next frame",
                "starts",
                "within",
                "converged",
                "falsely",
                "ends",
                "moves",
            ),
            loops,
        )
        yield _foreign(models, quick)


def _parts(name: str, draw: int) -> tuple[PoseImageSet, PoseImageSet]:
    """Frames to learn from, and those that the robot lives on."""
    read = read_kitchen() if name == "seven_scenes_kitchen" else read_tum_sequence(0.0)
    (images, poses, times), (image, T_ref), _ = read
    data = PoseImageSet(images, poses, T_ref, image, pivot=0.0, times=times, split="blocks")
    parts = real_images.split_by_blocks(times, SEQUENCES[name][1], draw)
    learned, live = (
        replace(data, images=images[i], T_world_cam=poses[i], times=times[i], names=())
        for i in parts
    )
    return learned, live


def _loops(
    title: str, model: KeyframeModel, live: PoseImageSet, draw: int
) -> Iterator[tuple[str, ...]]:
    within = np.flatnonzero((np.abs(live.delta_p()) <= model.reach).all(axis=1))
    starts = np.random.default_rng(draw).permutation(within)[:N_STARTS]
    for with_reference in (True, False):
        ends: Counter[str] = Counter()
        n_within, falsely, moves = 0, 0, []
        for start in starts:
            robot = RecordedRobot(live, int(start), with_reference=with_reference)
            loop = LoopSettings(read_timeout_s=None, move_timeout_s=None)
            loop = loop.for_poses_apart(*robot.spacing())
            result = Positioner(model, loop).run(robot, robot)
            at_reference = robot.from_reference().mm < 1e-6
            n_within += robot.is_within_spacing()
            falsely += result.status == "converged" and not at_reference
            ends[result.status] += 1
            moves.append(result.moves)
        others = [f"{n} {status}" for status, n in ends.items() if status != "converged"]
        yield (
            f"{title}, reference {'recorded' if with_reference else 'left out'}",
            str(len(live)),
            f"{robot.spacing().mm:.0f} mm",
            str(len(starts)),
            f"{n_within}/{len(starts)}",
            str(ends["converged"]),
            str(falsely),
            ", ".join(others) or "-",
            f"{np.median(moves):g}",
        )


def _foreign(models: dict[str, tuple[KeyframeModel, PoseImageSet]], quick: bool) -> Findings:
    n = 12 if quick else N_FOREIGN
    held_out = {name: _simulated(part, n, 1) for name, part in SIMULATED.items()}
    every = {name: data.images for name, data in held_out.items()} | _real_images(n)
    tried = {name: (model, live) for name, (model, live) in models.items()}
    for name, part in list(SIMULATED.items())[: 1 if quick else 2]:
        tried[name] = KeyframeModel.train(_simulated(part, 40, 0)), held_out[name]
    rows = []
    for name, (model, own) in tried.items():
        within = (np.abs(own.delta_p()) <= model.reach).all(axis=1)
        cells = [_refused(model, own.images[within])]
        shown = own.images[evenly(np.arange(len(own)), n)]
        for kind in FOREIGN:
            if kind.startswith("turned"):
                images = [_turned(image, float(kind.split()[-1])) for image in shown]
            else:
                images = [] if kind in name else list(every.get(kind, []))
            cells.append(_refused(model, images))
        rows.append((name, f"{model.accuracy['least_similarity']:.2f}", *cells))
    return Findings(
        "Images that do not show the part",
        "refused of those tried, by models of 40 images (simulated parts) or nine of twelve blocks "
        "(sequences); own = held out, within the range of training; limit = least similarity, "
        "which training found",
        ("model", "limit", "own", *FOREIGN),
        rows,
    )


def _simulated(part: str, n: int, seed: int) -> PoseImageSet:
    with tempfile.TemporaryDirectory() as folder:
        config = AcquisitionConfig(schedule=((n, 1.6),), part=part, seed=seed)
        return acquire(Path(folder) / "data", config, n_jobs=1)


def _real_images(n: int) -> dict[str, np.ndarray]:
    found = {}
    for kind, name in (("TUM", "tum_fr1_rpy"), ("kitchen", "seven_scenes_kitchen")):
        if (real_images.SHARED / name).exists():
            learned, live = _parts(name, 0)
            images = np.concatenate([learned.images, live.images])
            found[kind] = images[evenly(np.arange(len(images)), n)]
    if (real_images.SHARED / "kuka_board").exists():
        found["board"] = read_kuka()[0]
    return found


def _turned(image: np.ndarray, degrees: float) -> np.ndarray:
    height, width = image.shape
    M = cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), degrees, 1.0)
    return cv2.warpAffine(image, M, (width, height), borderMode=cv2.BORDER_REFLECT)


def _refused(model: KeyframeModel, images: list[np.ndarray] | np.ndarray) -> str:
    if not len(images):
        return "-"
    height, width = model.image_shape
    settings = LoopSettings()
    fitting = [cv2.resize(i, (width, height), interpolation=cv2.INTER_AREA) for i in images]
    faults = [novelty_fault(model.estimate(image), settings) for image in fitting]
    return f"{sum(fault is not None for fault in faults)}/{len(faults)}"
