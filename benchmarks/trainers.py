"""Trainers of one and the same tanh network, each leaving a trace of its test error."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import OptimizeResult, least_squares, minimize

from servoscope.regression.levenberg_marquardt import levenberg_marquardt, normal_equations
from servoscope.regression.tanh_network import (
    activate,
    append_ones,
    evaluate,
    initial_weights,
    linearise,
    split_weights,
)


@dataclass(frozen=True)
class Problem:
    """Samples of about unit scale, and the weights that every trainer starts from."""

    X: np.ndarray
    y: np.ndarray
    X_test: np.ndarray
    y_test: np.ndarray
    hidden: int
    seed: int

    @property
    def start(self) -> np.ndarray:
        """Random weights."""
        rng = np.random.default_rng(self.seed)
        return initial_weights(self.X.shape[1], self.hidden, rng)

    def residuals(self, weights: np.ndarray) -> np.ndarray:
        """Output minus target for the training samples."""
        return evaluate(weights, append_ones(self.X)) - self.y

    def test_rms(self, weights: np.ndarray) -> float:
        """Error for the test samples."""
        error = evaluate(weights, append_ones(self.X_test)) - self.y_test
        return float(np.sqrt(np.mean(error**2)))


@dataclass
class Trace:
    """Wall time, processor time and test error after each iteration."""

    problem: Problem
    points: list[tuple[float, float, float]] = field(default_factory=list)
    wall: float = field(default_factory=time.perf_counter)
    cpu: float = field(default_factory=time.process_time)

    def record(self, weights: np.ndarray) -> None:
        """Add a point; the time that this takes counts for nothing."""
        wall, cpu = time.perf_counter(), time.process_time()
        rms = self.problem.test_rms(weights)
        self.points.append((wall - self.wall, cpu - self.cpu, rms))
        self.wall += time.perf_counter() - wall
        self.cpu += time.process_time() - cpu

    @property
    def best_rms(self) -> float:
        """Least test error."""
        return min(rms for _, _, rms in self.points)

    def time_to(self, rms: float) -> tuple[float, float]:
        """Wall and processor time until the test error was first as low as this."""
        return next((wall, cpu) for wall, cpu, reached in self.points if reached <= rms)


Trainer = Callable[[Problem], Trace]


def servoscope(problem: Problem) -> Trace:
    """Ours, until its own stop; the time is spread evenly over the iterations."""
    p, trace = problem, Trace(problem)
    equations = normal_equations(append_ones(p.X), p.hidden)
    result = levenberg_marquardt(p.X, p.y, p.start, p.X_test, p.y_test, equations=equations)
    wall, cpu = time.perf_counter() - trace.wall, time.process_time() - trace.cpu
    for i in range(1, result.n_iter + 1):
        part = i / result.n_iter
        trace.points.append((wall * part, cpu * part, float(result.validation_rms[i])))
    return trace


def scipy_least_squares(problem: Problem) -> Trace:
    """Trust region reflective with the exact Jacobian."""
    inputs, trace = append_ones(problem.X), Trace(problem)

    def jacobian(weights: np.ndarray) -> np.ndarray:
        return linearise(weights, inputs, activate(weights, inputs)).jacobian()

    def note(intermediate_result: OptimizeResult) -> None:
        trace.record(intermediate_result.x)

    least_squares(problem.residuals, problem.start, jac=jacobian, max_nfev=25, callback=note)
    return trace


def scipy_lbfgs(problem: Problem) -> Trace:
    """L-BFGS with the exact gradient."""
    inputs, trace = append_ones(problem.X), Trace(problem)

    def loss_and_gradient(weights: np.ndarray) -> tuple[float, np.ndarray]:
        activations = activate(weights, inputs)
        residuals = activations @ split_weights(weights, inputs.shape[1])[1] - problem.y
        gradient = linearise(weights, inputs, activations).transposed_times(residuals)
        return residuals @ residuals / len(residuals), 2 * gradient / len(residuals)

    minimize(
        loss_and_gradient,
        problem.start,
        jac=True,
        method="L-BFGS-B",
        callback=trace.record,
        options={"maxiter": 1000, "maxfun": 2000},
    )
    return trace


def torch_levenberg_marquardt(problem: Problem) -> Trace:
    """The package torch-levenberg-marquardt, float32, by Cholesky, with its own damping."""
    import torch
    from torch_levenberg_marquardt.loss import MSELoss
    from torch_levenberg_marquardt.training import LevenbergMarquardtModule

    logging.getLogger("torch_levenberg_marquardt").setLevel(logging.CRITICAL)
    torch.set_num_threads(1)
    n_features = problem.X.shape[1]
    model = torch.nn.Sequential(
        torch.nn.Linear(n_features, problem.hidden),
        torch.nn.Tanh(),
        torch.nn.Linear(problem.hidden, 1),
    )
    inner, outer = model[0], model[2]
    W, v = split_weights(problem.start, n_features + 1)
    with torch.no_grad():
        for parameter, values in (
            (inner.weight, W[:, :-1]),
            (inner.bias, W[:, -1]),
            (outer.weight, v[None, :-1]),
            (outer.bias, v[-1:]),
        ):
            parameter.copy_(torch.tensor(values))

    def weights() -> np.ndarray:
        hidden = torch.cat([inner.weight, inner.bias[:, None]], dim=1).ravel()
        flat = torch.cat([hidden, outer.weight.ravel(), outer.bias])
        return flat.detach().numpy().astype(np.float64)

    X = torch.tensor(problem.X, dtype=torch.float32)
    y = torch.tensor(problem.y[:, None], dtype=torch.float32)
    trainer = LevenbergMarquardtModule(model, MSELoss(), solve_method="cholesky")
    trace = Trace(problem)
    for _ in range(40):
        _, _, stop, _ = trainer.training_step(X, y)
        trace.record(weights())
        if stop:
            break
    return trace
