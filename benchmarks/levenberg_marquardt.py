"""Training a network to a test error that every trainer reaches."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.util import find_spec
from statistics import median

import numpy as np
from threadpoolctl import threadpool_limits

import servoscope as sv
from benchmarks import trainers
from benchmarks.scenery import displaced_images
from benchmarks.timing import Table, Timing
from benchmarks.trainers import Problem, Trace, Trainer

N_TRAIN, N_TEST, HIDDEN = 750, 250, 30

TRAINERS: dict[str, Trainer] = {
    "servoscope": trainers.servoscope,
    "torch-levenberg-marquardt": trainers.torch_levenberg_marquardt,
    "scipy least_squares trf": trainers.scipy_least_squares,
    "scipy L-BFGS": trainers.scipy_lbfgs,
}


def tables(quick: bool) -> Iterator[Table]:
    """One table for a dof that the moments tell well and one for one that they tell poorly."""
    chosen = dict(TRAINERS)
    if find_spec("torch_levenberg_marquardt") is None:
        del chosen["torch-levenberg-marquardt"]
    images, delta_p = displaced_images(N_TRAIN + N_TEST, 64 if quick else 256)
    moments = sv.GeometricMoments().fit_transform(images)
    for dof in ("rz", "tz"):
        targets = delta_p[:, sv.DOFS.index(dof)]
        problems = [_problem(moments, targets, seed) for seed in range(2 if quick else 5)]
        with threadpool_limits(limits=1):
            yield _table(chosen, dof, problems)


def _table(chosen: dict[str, Trainer], dof: str, problems: list[Problem]) -> Table:
    for train in chosen.values():
        train(problems[0])
    runs = [{tool: train(p) for tool, train in chosen.items()} for p in problems]
    goal = 1.01 * max(trace.best_rms for run in runs for trace in run.values())
    n_features = problems[0].X.shape[1]
    return Table(
        f"Levenberg-Marquardt, {dof}",
        f"{n_features}-{HIDDEN}-1 tanh network from moments to {dof}, {N_TRAIN} training images, "
        f"to a test RMS of {goal:.3f} standard deviations from the same {len(problems)} starts, "
        "one thread",
        [_timing(tool, [run[tool] for run in runs], goal) for tool in chosen],
    )


def _timing(tool: str, traces: list[Trace], goal: float) -> Timing:
    times = [trace.time_to(goal) for trace in traces]
    per_iteration = median(trace.points[-1][1] / len(trace.points) for trace in traces)
    best = median(trace.best_rms for trace in traces)
    in_all = median(trace.points[-1][1] for trace in traces)
    return Timing(
        tool,
        wall=median(wall for wall, _ in times),
        cpu=median(cpu for _, cpu in times),
        estimated=False,
        remark=f"{1e3 * per_iteration:.2g} ms an iteration; best RMS {best:.3f}; "
        f"{in_all:.2g} s to its stop",
    )


def _problem(X: np.ndarray, y: np.ndarray, seed: int) -> Problem:
    X = (X - X[:N_TRAIN].mean(axis=0)) / X[:N_TRAIN].std(axis=0)
    y = (y - y[:N_TRAIN].mean()) / y[:N_TRAIN].std()
    return Problem(X[:N_TRAIN], y[:N_TRAIN], X[N_TRAIN:], y[N_TRAIN:], HIDDEN, seed)
