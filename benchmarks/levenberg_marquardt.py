"""Training a network to a test error that every trainer reaches."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.util import find_spec
from statistics import median

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks import trainers
from benchmarks.timing import Table, Timing
from benchmarks.trainers import Problem, Trace, Trainer

N_TRAIN, N_FEATURES, HIDDEN = 750, 24, 30

TRAINERS: dict[str, Trainer] = {
    "servoscope": trainers.servoscope,
    "torch-levenberg-marquardt": trainers.torch_levenberg_marquardt,
    "scipy least_squares trf": trainers.scipy_least_squares,
    "scipy L-BFGS": trainers.scipy_lbfgs,
}


def tables(quick: bool) -> Iterator[Table]:
    """One table for a dof that is told well and one for a dof that is told poorly."""
    chosen = dict(TRAINERS)
    if find_spec("torch_levenberg_marquardt") is None:
        del chosen["torch-levenberg-marquardt"]
    for name, strength in (("easy", 1.0), ("hard", 0.1)):
        with threadpool_limits(limits=1):
            yield _table(chosen, name, strength, n_starts=2 if quick else 5)


def _table(chosen: dict[str, Trainer], name: str, strength: float, n_starts: int) -> Table:
    problems = [_problem(strength, seed) for seed in range(n_starts)]
    for train in chosen.values():
        train(problems[0])
    runs = [{tool: train(p) for tool, train in chosen.items()} for p in problems]
    goal = 1.01 * max(trace.best_rms for run in runs for trace in run.values())
    timings = [_timing(tool, [run[tool] for run in runs], goal) for tool in chosen]
    return Table(
        f"Levenberg-Marquardt, {name} dof",
        f"{N_FEATURES}-{HIDDEN}-1 tanh network, {N_TRAIN} synthetic training samples, to a test "
        f"RMS of {goal:.3f} from the same {n_starts} starts, one thread",
        timings,
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


def _problem(strength: float, seed: int) -> Problem:
    """Features that are waves over six dofs, the last of which moves them by `strength`."""
    rng = np.random.default_rng(0)
    dofs = rng.uniform(-1, 1, (1000, 6))
    waves = rng.normal(size=(6, N_FEATURES)) * np.array([1, 1, 1, 1, 1, strength])[:, None]
    X = np.sin(dofs @ waves + rng.uniform(-1, 1, N_FEATURES))
    X += 0.03 * rng.normal(size=X.shape)
    X = (X - X.mean(axis=0)) / X.std(axis=0)
    y = dofs[:, -1] / dofs[:, -1].std()
    return Problem(X[:N_TRAIN], y[:N_TRAIN], X[N_TRAIN:], y[N_TRAIN:], HIDDEN, seed)
