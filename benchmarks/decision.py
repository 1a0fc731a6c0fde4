"""What one decision of the loop takes, and its parts; what the fit of a keyframe takes.

``python -m benchmarks decision``: a keyframe of 40 images reads images near the reference, as
after a move, and from all over the range, as at the start. Processor time of one thread.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from benchmarks.few_images import trained
from benchmarks.scenery import PIVOT, RANGES
from benchmarks.tables import Findings
from servoscope import AcquisitionConfig, Keyframe, acquire
from servoscope.keyframe.alignment import Aligner
from servoscope.keyframe.levels import Level
from servoscope.poses import poses_from_displacements
from servoscope.positioning.keyframe_model import keyframe_options
from servoscope.processes import one_blas_thread
from servoscope.scene.render import render
from servoscope.scene.scene import T_WORLD_REF, Scene

N_IMAGES, SIZE = 40, 256
PARTS: tuple[tuple[type, str], ...] = (
    (Level, "prepare"),
    (Level, "descend"),
    (Level, "linearise"),
    (Level, "compare"),
    (Aligner, "_covariance"),
)
"""Methods whose time is taken; what one calls counts in it as well."""


def tables(quick: bool) -> Iterator[Findings]:
    """Both tables."""
    n_read, repeats = (5, 2) if quick else (40, 5)
    model, scene, rng = trained("cylinder_head", "free", N_IMAGES), Scene(image_size=SIZE), _rng(1)
    rows = []
    for name, share in (("near the reference", 0.02), ("anywhere in the range", 1.0)):
        delta_p = share * _rng(0).uniform(-1, 1, (n_read, 6)) * RANGES
        poses = poses_from_displacements(T_WORLD_REF, delta_p, PIVOT)
        images = [render(scene, pose, rng) for pose in poses]
        previous = model.estimate(images[0]) if share < 1 else None

        def read(i: int, images=images, previous=previous) -> None:
            model.estimate(images[i], previous)

        with one_blas_thread():
            whole = _milliseconds(read, n_read, repeats)
            parts = [_part(owner, method, read, n_read) for owner, method in PARTS]
        rows.append((name, f"{whole:.1f}", *(f"{ms:.1f} ({n:.1f})" for ms, n in parts)))
    yield Findings(
        "One decision",
        f"Image of {SIZE} x {SIZE} of the cylinder head, keyframe of {N_IMAGES} images; processor "
        f"time, [ms], median of {n_read} images; calls in brackets",
        ("camera", "decision", *(method.strip("_") for _, method in PARTS)),
        rows,
    )
    yield Findings(
        "Fit of a keyframe",
        f"Images of {SIZE} x {SIZE} of the cylinder head",
        ("images", "processor s"),
        [(str(n), f"{fit_seconds(n):.1f}") for n in ((15,) if quick else (20, 40))],
    )


def fit_seconds(n_images: int) -> float:
    """Processor time of the second of two fits of a keyframe: the first may compile."""
    with tempfile.TemporaryDirectory() as folder:
        data = acquire(Path(folder) / "data", AcquisitionConfig(n_images=n_images))
    options, seconds = keyframe_options(data), 0.0
    with one_blas_thread():
        for _ in range(2):
            start = time.process_time()
            Keyframe.fit(
                data.images, data.T_world_cam, data.reference_image, data.T_world_ref, **options
            )
            seconds = time.process_time() - start
    return seconds


def _rng(seed: int) -> np.random.Generator:
    return np.random.default_rng([8, seed])


def _milliseconds(read: Callable[[int], None], n: int, repeats: int) -> float:
    """Median over the images of the least of some repeats."""
    least = []
    for i in range(n):
        times = []
        for _ in range(repeats):
            start = time.process_time()
            read(i)
            times.append(1e3 * (time.process_time() - start))
        least.append(min(times))
    return float(np.median(least))


def _part(owner: type, name: str, read: Callable[[int], None], n: int) -> tuple[float, float]:
    """Milliseconds of a method in a decision, and how often it is called."""
    method, spent = getattr(owner, name), []

    def timed(*args, **kwargs):
        start = time.process_time()
        try:
            return method(*args, **kwargs)
        finally:
            spent.append(1e3 * (time.process_time() - start))

    setattr(owner, name, timed)
    try:
        for i in range(n):
            read(i)
    finally:
        setattr(owner, name, method)
    return float(np.sum(spent)) / n, len(spent) / n
