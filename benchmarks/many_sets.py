"""Many data sets shared by workers, and what ten million images would take on a hundred of them.

``python -m benchmarks many_sets``; with ``--quick`` fewer and smaller sets. Processor seconds are
those of the workers, or of a command; seconds by the clock depend on what else the machine does,
and its load before is printed. Images are those of `many_images`.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.many_images import displacements, images_at, run, write_folder
from benchmarks.tables import Findings
from servoscope import PoseImageSet
from servoscope.cluster import on_cluster
from servoscope.commands.assessment_order import AssessmentOrder
from servoscope.commands.run_sets import assess_one
from servoscope.poses import poses_from_displacements
from servoscope.processes import in_processes
from servoscope.study import StudyConfig

N_SETS, N_IMAGES, SIZE = 6, 100, 64
COUNTS, COUNTS_QUICK = (2000, 4000, 10_000), (100, 200, 400)
"""Images of a set: the first and the last make the model, that between checks it."""

N_TOTAL, N_WORKERS, PER_SET = 10_000_000, 100, 10_000
FAMILIES = "moments"


def order() -> AssessmentOrder:
    """An assessment of one family."""
    config = StudyConfig(protocols=("honest",))
    families = tuple(FAMILIES.split(","))
    return AssessmentOrder(config, families, "gaussian_process", None, {}, {}, False, "1GB")


def write_set(folder: Path, seed: int) -> None:
    """A data set of a textured plane."""
    delta_p = displacements(N_IMAGES, seed)
    poses = poses_from_displacements(np.eye(4), delta_p, 0.55)
    images = images_at(delta_p, SIZE, seed)
    PoseImageSet(images, poses, np.eye(4), images[0], pivot=0.55).save(folder)


def shared(sets: list[str], n_workers: int) -> tuple[float, float, list[Any]]:
    """Seconds by the clock and of processors that warm workers take, and what they found."""
    with on_cluster(n_workers=n_workers) as cluster:
        list(in_processes(assess_one, [(order(), sets[0])] * n_workers, batch_size=1))
        before = sum(cluster.client.run(time.process_time).values())
        start = time.perf_counter()
        found = list(in_processes(assess_one, [(order(), one) for one in sets], batch_size=1))
        seconds = time.perf_counter() - start
        busy = sum(cluster.client.run(time.process_time).values()) - before
    return seconds, busy, [{**one.row, "seconds": None} for one in found]


def of_workers(n_sets: int) -> list[tuple[str, ...]]:
    """Rows: the same sets by one worker and by two."""
    with tempfile.TemporaryDirectory() as place:
        sets = [str(Path(place, f"set{i}")) for i in range(n_sets)]
        for i, one in enumerate(sets):
            write_set(Path(one), i)
        load = os.getloadavg()[0]
        one, two = (shared(sets, n) for n in (1, 2))
    if one[2] != two[2]:
        raise SystemExit("one worker and two found different figures")
    return [
        (f"{n}", f"{by[0]:.1f}", f"{by[1]:.1f}", f"{one[0] / by[0]:.2f}", f"{load:.1f}")
        for n, by in ((1, one), (2, two))
    ]


def of_one_set(n: int) -> tuple[float, float]:
    """Processor seconds to import and to assess a set of so many images."""
    with tempfile.TemporaryDirectory() as place:
        source, data = Path(place, "images"), Path(place, "data")
        write_folder(source, n)
        imported = run("import", "folder", source, data, "--reference", "000000.png").seconds
        out = ["--out", Path(place, "run"), "--jobs", 1, "--families", FAMILIES]
        return imported, run("assess", data, *out).seconds


def model(measured: dict[int, tuple[float, float]]) -> list[tuple[str, ...]]:
    """Rows: measured and modelled seconds of each size, and of all the images on all the workers.

    Of more images than an assessment is made of, both the import and the assessment take a time
    that grows in proportion to their number: the line through the least and the largest size.
    """
    (n0, first), _, (n1, second) = measured.items()
    slopes = [(b - a) / (n1 - n0) for a, b in zip(first, second, strict=True)]

    def modelled(n: int) -> list[float]:
        return [a + slope * (n - n0) for a, slope in zip(first, slopes, strict=True)]

    rows = [
        (f"{n:,}", *(f"{value:.1f}" for value in (*found, *modelled(n))))
        for n, found in measured.items()
    ]
    n_sets = N_TOTAL // PER_SET
    whole = [n_sets * seconds / 3600 for seconds in modelled(PER_SET)]
    hours = [f"{value:.1f} h" for value in whole]
    rows.append((f"{n_sets:,} x {PER_SET:,}", "", "", *hours))
    per_worker = -(-n_sets // N_WORKERS) * sum(modelled(PER_SET)) / 3600
    rows.append((f"the same by {N_WORKERS} workers", "", "", "", f"{per_worker:.2f} h"))
    return rows


def tables(quick: bool) -> Iterator[Findings]:
    """Both tables."""
    n_sets = 2 if quick else N_SETS
    yield Findings(
        "Workers",
        f"{n_sets} sets of {N_IMAGES} images of {SIZE} x {SIZE}, families {FAMILIES}, the same "
        "figures; workers are warm",
        ("workers", "seconds", "processor s", "times one", "load before"),
        of_workers(n_sets),
    )
    measured = {n: of_one_set(n) for n in (COUNTS_QUICK if quick else COUNTS)}
    yield Findings(
        "Ten million images",
        "Processor seconds of one set, measured and by a line through the least and the largest "
        "size, which that between checks; the last rows are of the line alone",
        ("images", "import", "assess", "import, model", "assess, model"),
        model(measured),
    )
