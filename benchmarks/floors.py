"""Kernels beside the machine's floor, measured in the same run on one thread.

``python -m benchmarks floors``. The floor of a kernel is the time that its bytes take to be read,
or its products and factorisations in the BLAS and LAPACK that NumPy and SciPy use.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from statistics import median

import numpy as np
from scipy.linalg import blas, lapack
from threadpoolctl import threadpool_limits

import servoscope as sv
from benchmarks import trainers
from benchmarks.scenery import displaced_images
from benchmarks.tables import Findings
from benchmarks.trainers import Problem
from servoscope.features import compute_image_basis
from servoscope.features.moments import PAPER_SLICES, compute_raw_moments
from servoscope.kernels.gaussian import negative_log_likelihood

N_COMPONENTS, HIDDEN, N_TRAIN = 35, 30, 750


def tables(quick: bool) -> Iterator[Findings]:
    """The machine, and the kernels."""
    with threadpool_limits(limits=1):
        rows, machine = list(_kernels(quick)), _machine(quick)
    yield Findings(
        "The machine's floor", "What one thread does at most", ("what", "reached"), machine
    )
    yield Findings(
        "Kernels and their floors",
        "Wall time of one thread, medians in one run",
        ("kernel", "floor ms", "ours ms", "ours / floor", "the floor is"),
        rows,
    )


def _machine(quick: bool) -> list[tuple[str, str]]:
    n = 500 if quick else 1500
    block = np.ones(2**24 if quick else 2**27, np.uint8)
    rows = [
        ("bytes read from memory", f"{len(block) / _seconds(lambda: _read(block)) / 1e9:.3g} GB/s")
    ]
    for dtype in (np.float32, np.float64):
        A = np.ones((n, n), dtype)
        rate = 2 * n**3 / _seconds(lambda A=A: A @ A) / 1e9
        rows.append((f"products of {np.dtype(dtype)} matrices", f"{rate:.3g} GFlop/s"))
    rate = n**3 / 3 / _seconds(lambda: _cholesky(n)) / 1e9
    rows.append((f"Cholesky factors of float64, {n} x {n}", f"{rate:.3g} GFlop/s"))
    return rows


def _kernels(quick: bool) -> Iterator[tuple[str, ...]]:
    n_images, size = (200, 64) if quick else (1000, 256)
    images, delta_p = displaced_images(n_images, size)
    flat = images.reshape(len(images), -1)
    yield _row(
        f"moments of {n_images} images of {size} x {size}",
        lambda: _read(flat.ravel()),
        lambda: compute_raw_moments(images, PAPER_SLICES),
        "every pixel read once",
    )
    X = flat.astype(np.float32)
    weights = np.ones((N_COMPONENTS, len(X)), np.float32)
    yield _row(
        f"{N_COMPONENTS} eigenvectors of them",
        lambda: (blas.ssyrk(1.0, X), weights @ X),
        lambda: compute_image_basis(images, N_COMPONENTS),
        "inner products and weighted sums, float32",
    )
    features = sv.GeometricMoments().fit_transform(images)
    features = (features - features.mean(axis=0)) / features.std(axis=0)
    y = delta_p[:, 5] / delta_p[:, 5].std()
    n = 200 if quick else 600
    parameters = np.log(np.append(np.full(features.shape[1], 0.1), [1.0, 0.1]))
    yield _row(
        f"likelihood of a Gaussian process and its slope, {n} samples",
        lambda: _inverse(n),
        lambda: negative_log_likelihood(parameters, features[:n], y[:n]),
        "one Cholesky factor and the inverse from it, float64",
    )
    n_train = min(N_TRAIN, n_images * 3 // 4)
    parts = slice(n_train), slice(n_train, None)
    problem = Problem(*(v[part] for part in parts for v in (features, y)), HIDDEN, 0)
    n_steps = len(trainers.servoscope(problem).points)
    n_weights = len(problem.start)
    J = np.ones((n_train, n_weights), np.float32)
    yield _row(
        f"a step of Levenberg-Marquardt, {n_weights} weights, {n_train} samples",
        lambda: (blas.ssyrk(1.0, J), _factor(n_train)),
        lambda: trainers.servoscope(problem),
        "one product of the Jacobian and one Cholesky factor, float32",
        n_steps,
    )


def _row(
    kernel: str,
    floor: Callable[[], object],
    ours: Callable[[], object],
    what: str,
    times: int = 1,
) -> tuple[str, ...]:
    least, own = _seconds(floor), _seconds(ours) / times
    return kernel, f"{1e3 * least:.3g}", f"{1e3 * own:.3g}", f"{own / least:.2g}", what


def _seconds(run: Callable[[], object], repeats: int = 5) -> float:
    run()
    found = []
    for _ in range(repeats):
        start = time.perf_counter()
        run()
        found.append(time.perf_counter() - start)
    return median(found)


def _read(block: np.ndarray) -> int:
    """Read all bytes, eight at a time."""
    return int(np.bitwise_xor.reduce(block[: len(block) // 8 * 8].view(np.uint64)))


def _cholesky(n: int) -> np.ndarray:
    return lapack.dpotrf(np.asfortranarray(n * np.eye(n)), lower=1, overwrite_a=1)[0]


def _factor(n: int) -> np.ndarray:
    return lapack.spotrf(np.asfortranarray(n * np.eye(n, dtype=np.float32)), lower=1)[0]


def _inverse(n: int) -> np.ndarray:
    return lapack.dpotri(_cholesky(n), lower=1, overwrite_c=1)[0]
