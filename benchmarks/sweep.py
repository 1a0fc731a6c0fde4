"""Many networks side by side: the nets of a sweep over subset sizes."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np

import servoscope as sv
from benchmarks.scenery import RANGES, displaced_images
from benchmarks.timing import Table, Timing
from servoscope.data.splits import Split

N_TRAIN, N_TEST, RESTARTS = 750, 250, 3


def tables(quick: bool) -> Iterator[Table]:
    """One table: one process and all cores."""
    images, delta_p = displaced_images(N_TRAIN + N_TEST, 64 if quick else 256)
    X = _features(images, delta_p)
    sizes = np.unique(np.linspace(2, X.shape[1], 4 if quick else 20).round().astype(int))
    jobs = [(_recipe(size, target), dof) for size in sizes for target, dof in enumerate(sv.DOFS)]
    n_nets = len(jobs) * RESTARTS
    timings = [_timing(X, delta_p / RANGES, jobs, n_jobs) for n_jobs in (-1, 1)]
    yield Table(
        "Nets side by side",
        f"{n_nets} nets of {sizes[0]} to {sizes[-1]} inputs, 30 hidden units, {N_TRAIN} training "
        "images, start of the processes included (target for 360: 15 s on 2 cores)",
        timings,
    )


def _recipe(size: int, target: int) -> sv.Recipe:
    settings = {"restarts": RESTARTS, "random_state": target}
    return sv.Recipe("own", tuple(map(str, range(size))), "levenberg_marquardt", settings)


def _features(images: np.ndarray, delta_p: np.ndarray) -> np.ndarray:
    """The 65 candidates of the study, in an order that mixes the families."""
    families = (sv.GeometricMoments(), sv.Eigenfeatures(35), sv.PoseImageCovariance())
    X = np.hstack([family.fit(images, delta_p).transform(images) for family in families])
    return X[:, np.random.default_rng(0).permutation(X.shape[1])]


def _timing(X: np.ndarray, Y: np.ndarray, jobs: list[tuple[sv.Recipe, str]], n_jobs: int) -> Timing:
    split = Split(np.arange(N_TRAIN), np.arange(N_TRAIN, N_TRAIN + N_TEST), np.arange(0))
    table = sv.FeatureTable(X, tuple(map(str, range(X.shape[1]))), ("own",) * X.shape[1])
    start = time.perf_counter()
    nets = [one.regressor for one in sv.fit_all(table, Y, split, jobs, n_jobs=n_jobs)]
    wall = time.perf_counter() - start
    steps = sum(result.n_iter for net in nets for result in net.results_)
    name = "all cores" if n_jobs == -1 else "one process"
    return Timing(name, wall, None, False, f"{steps / (len(nets) * RESTARTS):.1f} steps a net")
