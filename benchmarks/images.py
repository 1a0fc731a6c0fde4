"""Images per second, from the ray caster to the features."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any
from unittest.mock import patch

import numpy as np

import servoscope as sv
from benchmarks.scenery import PIVOT, RANGES, displaced_images
from benchmarks.tables import Findings
from benchmarks.timing import Contender, Table, Timing, race
from servoscope.acquisition import AcquisitionConfig, acquire
from servoscope.poses import poses_from_displacements
from servoscope.scene import tracing
from servoscope.scene.camera import Sensor
from servoscope.scene.render import prepare, render
from servoscope.scene.scene import T_WORLD_REF, Scene


def tables(quick: bool) -> Iterator[Table | Findings]:
    """The rates, and what a frame of the ray caster consists of."""
    n_images, size = (200, 128) if quick else (1000, 256)
    with TemporaryDirectory() as folder:
        timings = race(_contenders(n_images, size, Path(folder)), repeats=3)
        timings.append(_acquisition(n_images, size, Path(folder)))
    yield Table(
        "Images",
        f"{n_images} images of {size} x {size}; the ratio is to the first line",
        [replace(t, remark=f"{n_images / t.wall:,.0f} images/s") for t in timings],
    )

    yield _profile(20 if quick else 100, size)


_PARTS = (
    ("faces outlined in the view", tracing, "outlines"),
    ("first faces along the rays", tracing, "first_hits"),
    ("light of the surfaces", tracing, "shade"),
    ("shadow rays", tracing, "blockers"),
    ("pixels that differ found", tracing, "steep_pixels"),
    ("pixels that differ averaged", tracing, "average_in"),
    ("sensor", Sensor, "read_out"),
)
"""Parts of a frame, and the functions that do them."""


def _profile(n_frames: int, size: int) -> Findings:
    """Processor time of the parts of a frame, medians over frames."""
    scene, rng = Scene(image_size=size), np.random.default_rng(0)
    prepare(scene)
    delta_p = rng.uniform(-1, 1, (n_frames, 6)) * RANGES
    clocks = {name: 0.0 for name, _, _ in _PARTS}
    frames = []
    with ExitStack() as patches:
        for name, place, function in _PARTS:
            timed = _timed(getattr(place, function), name, clocks)
            patches.enter_context(patch.object(place, function, timed))
        for pose in poses_from_displacements(T_WORLD_REF, delta_p, PIVOT):
            clocks.update(dict.fromkeys(clocks, 0.0))
            start = time.process_time()
            render(scene, pose, rng)
            frames.append({**clocks, "whole frame": time.process_time() - start})
    medians = {name: median(frame[name] for frame in frames) for name in frames[0]}
    rows = [
        (name, f"{1e3 * clock:.2f}", f"{clock / medians['whole frame']:.0%}")
        for name, clock in medians.items()
    ]
    return Findings(
        "Ray caster",
        f"processor time of a frame of {size} x {size}, one process, medians of {n_frames} frames",
        ("part", "ms", "share"),
        rows,
    )


def _timed(function: Callable[..., Any], name: str, clocks: dict[str, float]) -> Any:
    """The function, whose processor time is added to a clock."""

    def run(*arguments: Any) -> Any:
        start = time.process_time()
        result = function(*arguments)
        clocks[name] += time.process_time() - start
        return result

    return run


def _acquisition(n_images: int, size: int, folder: Path) -> Timing:
    config = AcquisitionConfig(n_images=n_images, image_size=size)
    start = time.perf_counter()
    acquire(folder / "acquired", config)
    return Timing("acquire, all cores", time.perf_counter() - start, None, False, "")


def _contenders(n_images: int, size: int, folder: Path) -> list[Contender]:
    images, delta_p = displaced_images(n_images, size)
    poses = poses_from_displacements(T_WORLD_REF, delta_p, PIVOT)
    data = sv.PoseImageSet(images, poses, T_WORLD_REF, images[0], pivot=PIVOT, pivot_ranges=RANGES)
    data.save(folder / "read")
    n_rendered = n_images // 20
    scene = Scene(image_size=size)
    written = (folder / f"written_{i}" for i in range(n_images))
    families = [
        sv.GeometricMoments(),
        sv.Eigenfeatures(n_components=35),
        sv.PoseImageCovariance(),
        sv.LocalFeatureAnalysis(n_components=35),
    ]
    features = [
        Contender(
            f"{type(family).__name__} fit and transform",
            lambda family=family: family.fit(images, delta_p).transform(images),
        )
        for family in families
    ]
    return [
        Contender(
            "ray caster, one process",
            lambda: [render(scene, pose) for pose in poses[:n_rendered]],
            n_images / n_rendered,
        ),
        Contender("data set folder, written", lambda: data.save(next(written))),
        Contender("data set folder, read", lambda: sv.PoseImageSet.load(folder / "read")),
        *features,
    ]
