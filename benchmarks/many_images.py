"""Time and memory of an import and an assessment of many images, and what a sample of them loses.

``python -m benchmarks many_images``; with ``--quick`` 1000 and 2000 images, not up to 100 000.
``python -m benchmarks.many_images --figure FILE`` draws the times and the memory.
The images are of a textured plane, 128 x 128 px, warped and not rendered. The commands run in one
process each; the most memory is that of the process.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from benchmarks.tables import Findings, as_text
from servoscope import GaussianProcess, IntensityMoments
from servoscope.data.splits import MOST_IMAGES
from servoscope.poses import DOFS, poses_from_displacements, quaternions_xyzw
from servoscope.processes import in_processes, one_blas_thread

SIZE = 128
N_IMAGES, N_QUICK = (5_000, 10_000, 20_000, 50_000, 100_000), (1_000, 2_000)
N_LEARNED, N_TEST = (500, 1000, 1500, 3000, 6000), 1500
"""Images learned from, of which 1500 are those of an assessment of many, and tested on."""

PIVOT, NOISE = 0.55, 2.0
RANGES = np.array([0.025] * 3 + [np.radians(15)] * 3)
_BLOCK = 500

Array = NDArray[np.float64]
Images = NDArray[np.uint8]


def displacements(n: int, seed: int = 0) -> Array:
    """Displacements drawn evenly from the range; none of the first."""
    delta_p = np.random.default_rng(seed).uniform(-1, 1, (n, 6)) * RANGES
    delta_p[0] = 0
    return delta_p


def images_at(delta_p: Array, size: int, seed: int) -> Images:
    """Images of a random smooth texture on a plane at the pivot, with noise."""
    texture = np.random.default_rng(0).normal(size=(192, 192)).astype(np.float32)
    texture = cv2.normalize(cv2.GaussianBlur(texture, (0, 0), 4), None, 0, 255, cv2.NORM_MINMAX)
    K = np.array([[1.4 * size, 0, size / 2], [0, 1.4 * size, size / 2], [0, 0, 1]])
    to_plane = np.array([[192 / 0.5, 0, 96], [0, 192 / 0.5, 96], [0, 0, 1]])
    rng, images = np.random.default_rng([1, seed]), []
    for T in poses_from_displacements(np.eye(4), delta_p, PIVOT):
        R, t = T[:3, :3].T, -T[:3, :3].T @ T[:3, 3]
        H = K @ np.column_stack([R[:, 0], R[:, 1], PIVOT * R[:, 2] + t]) @ np.linalg.inv(to_plane)
        seen = cv2.warpPerspective(texture, H, (size, size), borderValue=230)
        images.append(seen + NOISE * rng.standard_normal((size, size), np.float32))
    return np.rint(np.clip(images, 0, 255)).astype(np.uint8)


def write_folder(folder: Path, n: int) -> None:
    """Write images with their poses.csv."""
    folder.mkdir()
    delta_p = displacements(n)
    poses = poses_from_displacements(np.eye(4), delta_p, PIVOT)
    numbers = np.hstack([poses[:, :3, 3], quaternions_xyzw(poses)])
    with open(folder / "poses.csv", "w", encoding="utf-8") as file:
        file.write("name,tx,ty,tz,qx,qy,qz,qw\n")
        for i, row in enumerate(numbers.tolist()):
            file.write(f"{i:06d}.png,{','.join(map(repr, row))}\n")
    calls = [(folder, start, delta_p[start : start + _BLOCK]) for start in range(0, n, _BLOCK)]
    list(in_processes(_write_block, calls))


def _write_block(folder: Path, start: int, delta_p: Array) -> None:
    for i, image in enumerate(images_at(delta_p, SIZE, start), start):
        cv2.imwrite(str(folder / f"{i:06d}.png"), image, [cv2.IMWRITE_PNG_COMPRESSION, 1])


class Used(NamedTuple):
    """Processor time, [s], and the most memory of a process, [GB]."""

    seconds: float
    memory: float


class Commands(NamedTuple):
    """What the import and the assessment of so many images use."""

    n_images: int
    imported: Used
    assessed: Used


def run(*arguments: object) -> Used:
    """What a command uses."""
    command = [sys.executable, "-m", "servoscope", *map(str, arguments)]
    with open(os.devnull, "wb") as nowhere:
        actions = [(os.POSIX_SPAWN_DUP2, nowhere.fileno(), stream) for stream in (1, 2)]
        pid = os.posix_spawn(sys.executable, command, os.environ, file_actions=actions)
        _, status, usage = os.wait4(pid, 0)
    if status:
        raise SystemExit(f"{' '.join(command)} ended with {os.waitstatus_to_exitcode(status)}")
    return Used(usage.ru_utime + usage.ru_stime, usage.ru_maxrss * 1024 / 1e9)


def of_commands(n: int) -> Commands:
    """Import so many images, and assess them."""
    with tempfile.TemporaryDirectory() as place:
        source, data = Path(place, "images"), Path(place, "data")
        write_folder(source, n)
        imported = run("import", "folder", source, data, "--reference", "000000.png")
        assessed = run("assess", data, "--out", Path(place, "run"), "--jobs", 1)
    return Commands(n, imported, assessed)


def table_of_commands(rows: Sequence[Commands]) -> Findings:
    """A row for each number of images."""
    return Findings(
        "Many images",
        f"Import and assessment of images of {SIZE} x {SIZE}, one process, --memory 1GB: processor "
        f"time and most memory; an assessment is made of {MOST_IMAGES} of them",
        ("images", "import s", "import GB", "assess s", "assess GB"),
        [
            (f"{n:,}", *(f"{value:.3g}" for value in (*imported, *assessed)))
            for n, imported, assessed in rows
        ],
    )


def draw_commands(rows: Sequence[Commands]) -> Figure:
    """Time and memory by the number of images."""
    import matplotlib.pyplot as plt

    n = np.array([row.n_images for row in rows])
    figure, (times, memories) = plt.subplots(1, 2, figsize=(8, 3.2), layout="constrained")
    for ax, field in ((times, "seconds"), (memories, "memory")):
        for name, marker, style in (("imported", "o", "-"), ("assessed", "s", "--")):
            values = [getattr(getattr(row, name), field) for row in rows]
            ax.plot(n, values, style, marker=marker, color="0.0", markerfacecolor="1", label=name)
        ax.set(xscale="log", xlabel="images")
        ax.set_xticks(n, [f"{k:,}".replace(",", "\N{THIN SPACE}") for k in n], minor=False)
        ax.minorticks_off()
    proportional = rows[-1].imported.seconds * n / n[-1]
    times.plot(n, proportional, ":", color="0.5", label="in proportion")
    times.set(yscale="log", ylabel="processor time [s]")
    memories.axhline(1.0, color="0.5", linestyle=":", label="1 GB")
    memories.set(ylim=(0, None), ylabel="most memory of the process [GB]")
    for ax in (times, memories):
        ax.legend(loc="lower right", frameon=False)
    return figure


def losses(n_learned: tuple[int, ...], n_test: int) -> list[tuple[str, ...]]:
    """Rows: error of a Gaussian process on intensity moments, by the images that it has."""
    n = max(n_learned)
    delta_p = displacements(n + n_test, seed=1)
    images = np.concatenate(
        [
            images_at(delta_p[start : start + _BLOCK], SIZE, start)
            for start in range(0, len(delta_p), _BLOCK)
        ]
    )
    X, y = IntensityMoments().fit_transform(images), delta_p / RANGES
    rows = []
    for m in n_learned:
        some = np.linspace(0, n - 1, m).round().astype(int)
        start = time.perf_counter()
        with one_blas_thread():
            errors = [
                GaussianProcess(max_samples=m).fit(X[some], y[some, k]).predict(X[n:]) - y[n:, k]
                for k in range(len(DOFS))
            ]
        seconds = time.perf_counter() - start
        rms = np.sqrt(np.mean(np.square(errors), axis=1))
        rows.append((f"{m:,}", *(f"{100 * value:.3g}" for value in rms), f"{seconds:.3g}"))
    return rows


def tables(quick: bool) -> Iterator[Findings]:
    """Both tables."""
    yield table_of_commands([of_commands(n) for n in (N_QUICK if quick else N_IMAGES)])
    learned = (200, 400) if quick else N_LEARNED
    yield Findings(
        "What a sample loses",
        f"RMS error of a Gaussian process on intensity moments over {N_TEST} other images, in % of "
        "the range, by the images that it is trained on",
        ("images", *DOFS, "training s"),
        losses(learned, N_TEST),
    )


def main() -> None:
    """Measure the commands and draw what they use."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--quick", action="store_true", help="few images")
    parser.add_argument("--figure", type=Path, required=True, metavar="FILE")
    options = parser.parse_args()
    rows = [of_commands(n) for n in (N_QUICK if options.quick else N_IMAGES)]
    print(as_text(table_of_commands(rows)))
    draw_commands(rows).savefig(options.figure, dpi=150)


if __name__ == "__main__":
    main()
