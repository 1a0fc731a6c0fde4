"""Images per second, from the ray caster to the features."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import servoscope as sv
from benchmarks.scenery import PIVOT, RANGES, displaced_images
from benchmarks.timing import Contender, Table, Timing, race
from servoscope.acquisition import AcquisitionConfig, acquire
from servoscope.poses import poses_from_displacements
from servoscope.scene.render import render
from servoscope.scene.scene import T_WORLD_REF, Scene


def tables(quick: bool) -> Iterator[Table]:
    """One table."""
    n_images, size = (200, 128) if quick else (1000, 256)
    with TemporaryDirectory() as folder:
        timings = race(_contenders(n_images, size, Path(folder)), repeats=3)
        timings.append(_acquisition(n_images, size, Path(folder)))
    yield Table(
        "Images",
        f"{n_images} images of {size} x {size}; the ratio is to the first line",
        [replace(t, remark=f"{n_images / t.wall:,.0f} images/s") for t in timings],
    )


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
