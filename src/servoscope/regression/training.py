"""Training of a network: early stopping, L-BFGS, and the best of several starts."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, minimize

from servoscope.processes import one_blas_thread
from servoscope.regression.samples import Shots
from servoscope.regression.tanh_network import (
    Array,
    Objective,
    Point,
    append_ones,
    count_weights,
    evaluate,
    initial_weights,
)

Status = Literal["stopped_early", "converged", "max_iter", "damping_limit"]


@dataclass(frozen=True, eq=False)
class TrainingResult:
    """What training from one start gave:

    the weights of the best iteration, why it ended, the number of steps, and the errors before the
    first step and after each, in units of the target.

    It ends where the validation error stopped falling, the training error did, the steps ran out,
    or no damping gave a step that lowers the training error. Without validation its errors are NaN,
    and the last iteration is the best.
    """

    weights: NDArray[np.float64]
    status: Status
    n_iter: int
    best_iteration: int
    training_rms: NDArray[np.float64]
    validation_rms: NDArray[np.float64]

    @property
    def best_rms(self) -> float:
        """Validation error of `weights`, or training error where there was no validation."""
        rms = self.training_rms if np.isnan(self.validation_rms).any() else self.validation_rms
        return float(rms[self.best_iteration])

    @property
    def loss(self) -> float:
        """By which the best of several starts is chosen, the least one: `best_rms`."""
        return self.best_rms


_N_PARTS = 4
"""Parts of the samples that are left out in turn where no others show how large errors are."""


class EarlyStopping:
    """The points that training passes, the best of them, and for how long none was better.

    Training is over after `patience` steps without a validation error lower by a share of
    `min_improvement`.
    """

    def __init__(self, start: Point, patience: int, min_improvement: float) -> None:
        self._patience, self._min_improvement = patience, min_improvement
        self._history = [(start.training_rms, start.validation_rms)]
        self._best, self._best_iteration, self._idle = start, 0, 0

    def note(self, point: Point) -> None:
        """Take note of the point that a step led to."""
        self._history.append((point.training_rms, point.validation_rms))
        # Written so that every point is the best where the validation error is NaN.
        notable = (1 - self._min_improvement) * self._best.validation_rms
        self._idle = self._idle + 1 if point.validation_rms >= notable else 0
        if not point.validation_rms >= self._best.validation_rms:
            self._best, self._best_iteration = point, self.n_iter

    @property
    def n_iter(self) -> int:
        """Number of steps so far."""
        return len(self._history) - 1

    @property
    def is_over(self) -> bool:
        """Whether the validation error has not fallen notably for as long as is waited for."""
        return self._idle >= self._patience

    def result(self, status: Status) -> TrainingResult:
        """What training gave."""
        training_rms, validation_rms = np.array(self._history).T
        return TrainingResult(
            self._best.weights.copy(),
            status,
            self.n_iter,
            self._best_iteration,
            training_rms,
            validation_rms,
        )


class Settings(Protocol):
    """A way of training, such as `LMSettings`."""

    def trainer(self, X: Array, hidden: int) -> Callable[..., TrainingResult]:
        """What trains from a start on inputs X, called as `levenberg_marquardt` is."""


@dataclass(frozen=True, eq=False)
class Standardisation:
    """Shift and scale to zero mean and unit variance."""

    mean: Array
    scale: Array

    @classmethod
    def of(cls, samples: Array, scale_of_constant: float) -> Standardisation:
        """That of samples along the first axis, with a fixed scale for what is constant."""
        samples = np.ascontiguousarray(samples)  # the order of a sum shows in its last bits
        mean, deviation = samples.mean(axis=0), samples.std(axis=0)
        varies = deviation > 1e-12 * np.abs(samples).max(axis=0)
        return cls(
            mean, np.where(varies, 1.0 / np.where(varies, deviation, 1.0), scale_of_constant)
        )

    def apply(self, samples: Array) -> Array:
        return (samples - self.mean) * self.scale


@dataclass(frozen=True, eq=False)
class TrainedNetwork:
    """The best of some training runs, with the scales it works in, and what each start gave.

    `error` is the RMS error at samples that it was not trained on; NaN where that is not known.
    """

    weights: Array
    inputs: Standardisation
    target: Standardisation
    results: tuple[TrainingResult, ...] = ()
    best: int = 0
    error: float = float("nan")

    def predict(self, X: Array) -> Array:
        """The target at ``X`` of shape (n, k)."""
        output = evaluate(self.weights, append_ones(self.inputs.apply(X)))
        return self.target.mean + output / self.target.scale


def train_restarts(
    X: Array,
    y: Array,
    X_val: Array | None,
    y_val: Array | None,
    *,
    hidden: int,
    restarts: int,
    seed: int,
    settings: Settings,
) -> TrainedNetwork:
    """Train from `restarts` random starts and keep the start of the least `loss`.

    Runs with one BLAS thread, so that a seed gives the same weights in any process. A constant
    target needs no search: all weights are zero.
    """
    n_features = X.shape[1]
    starts = _starts(n_features, hidden, restarts, seed)
    if not np.ptp(y):
        starts = iter([np.zeros(count_weights(n_features, hidden))])
    inputs, target = Standardisation.of(X, 0.0), Standardisation.of(y, 1.0)
    X, y = inputs.apply(X), target.apply(y)
    if X_val is not None and y_val is not None:
        X_val, y_val = inputs.apply(X_val), target.apply(y_val)
    with one_blas_thread():
        train = settings.trainer(X, hidden)
        results = [train(X, y, start, X_val, y_val) for start in starts]
    best = int(np.argmin([result.loss for result in results]))
    scaled = tuple(_rescale(result, 1.0 / float(target.scale)) for result in results)
    error = float("nan") if X_val is None else scaled[best].best_rms
    return TrainedNetwork(results[best].weights, inputs, target, scaled, best, error)


def rms_left_out(shots: Shots, options: Mapping[str, Any]) -> float:
    """RMS error at shots of poses that networks trained in the same way have not seen.

    A network without validation samples has no error of its own but that of training, which is as
    small as its weights are many. So others are trained without each of a few parts of the poses,
    from one start.
    """
    n_poses = len(shots.poses.y)
    order = np.random.default_rng(0).permutation(n_poses)
    squares = np.empty(len(shots.each.y))
    for part in np.array_split(order, min(_N_PARTS, n_poses)):
        others = np.delete(np.arange(n_poses), part)
        unseen = np.isin(shots.members, part)
        network = train_restarts(
            *(shots.poses.X[others], shots.poses.y[others], None, None),
            **{**options, "restarts": 1},
        )
        squares[unseen] = (shots.each.y[unseen] - network.predict(shots.each.X[unseen])) ** 2
    return float(np.sqrt(np.mean(shots.mean_of_poses(squares))))


def _starts(n_features: int, hidden: int, restarts: int, seed: int) -> Iterator[Array]:
    for restart in range(restarts):
        yield initial_weights(n_features, hidden, np.random.default_rng([seed, restart]))


def _rescale(result: TrainingResult, factor: float) -> TrainingResult:
    return replace(
        result,
        training_rms=result.training_rms * factor,
        validation_rms=result.validation_rms * factor,
    )


@dataclass(frozen=True)
class LBFGSSettings:
    """How a network is trained; names that `LMSettings` has too mean the same."""

    max_iter: int = 1000
    patience: int = 50
    weight_decay: float = 0.1
    min_improvement: float = 0.005
    tol: float = 1e-6

    def trainer(self, X: Array, hidden: int) -> Callable[..., TrainingResult]:
        """What trains from a start; see `lbfgs`."""
        return partial(lbfgs, settings=self)


def lbfgs(
    X: Array,
    y: Array,
    weights: Array,
    X_val: Array | None = None,
    y_val: Array | None = None,
    settings: LBFGSSettings | None = None,
) -> TrainingResult:
    """Train a network as `levenberg_marquardt` does, by L-BFGS.

    References
    ----------
    Liu, D. and Nocedal, J.: On the limited memory BFGS method for large scale optimization,
    Mathematical Programming 45 (1989), 503-528.
    """
    settings = settings or LBFGSSettings()
    objective = Objective(X, y, X_val, y_val, settings.weight_decay)
    point = objective.at(weights)
    stopping = EarlyStopping(point, settings.patience, settings.min_improvement)

    def cost(weights: Array) -> tuple[float, Array]:
        nonlocal point
        point = objective.at(weights)
        return point.cost, objective.gradient(point)

    def note(intermediate_result: OptimizeResult) -> None:
        reached = intermediate_result.x
        is_last = np.array_equal(point.weights, reached)
        stopping.note(point if is_last else objective.at(reached.copy()))
        if stopping.is_over:
            raise StopIteration

    found = minimize(
        cost,
        weights,
        jac=True,
        method="L-BFGS-B",
        callback=note,
        options={
            "maxiter": settings.max_iter,
            "maxfun": 10 * settings.max_iter,
            "maxcor": 20,
            "ftol": settings.tol,
            "gtol": 0.0,
        },
    )
    status: Status = "converged" if found.success else "max_iter"
    return stopping.result("stopped_early" if stopping.is_over else status)
