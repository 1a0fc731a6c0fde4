"""L-BFGS training of a tanh network, stopped early on validation samples."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.optimize import OptimizeResult, minimize

from servoscope.regression.objective import Objective, Point
from servoscope.regression.tanh_network import Array
from servoscope.regression.training_result import Status, TrainingResult


@dataclass(frozen=True)
class LBFGSSettings:
    """How a network is trained.

    Parameters
    ----------
    max_iter : int
        Most steps taken.
    patience : int
        Steps without a notably lower validation error after which training stops.
    weight_decay : float
        Factor of the squared weights in what is minimised, the squared residuals summed over
        the samples plus ``weight_decay`` times the squared weights.
    min_improvement : float
        Relative fall of the validation error that counts as notable.
    tol : float
        Relative fall of what is minimised below which training has converged.
    """

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
    """Train a network of tanh hidden units and one linear output from the given weights.

    Parameters
    ----------
    X : ndarray of shape (n, k)
        Inputs of about unit scale.
    y : ndarray of shape (n,)
        Target of about unit scale.
    weights : ndarray of shape (h (k + 2) + 1,)
        Weights to start from, in the order of `servoscope.regression.tanh_network`.
    X_val, y_val : ndarray of shape (n_val, k) and (n_val,), optional
        Samples that stop the training and choose its best iteration.
    settings : LBFGSSettings, optional

    Returns
    -------
    TrainingResult

    References
    ----------
    Liu, D. and Nocedal, J.: On the limited memory BFGS method for large scale optimization,
    Mathematical Programming 45 (1989), 503-528.
    """
    settings = settings or LBFGSSettings()
    watch = _Watch(Objective(X, y, X_val, y_val, settings.weight_decay), weights, settings)
    found = minimize(
        watch.cost,
        weights,
        jac=True,
        method="L-BFGS-B",
        callback=watch.look,
        options={
            "maxiter": settings.max_iter,
            "maxfun": 10 * settings.max_iter,
            "maxcor": 20,
            "ftol": settings.tol,
            "gtol": 0.0,
        },
    )
    status: Status = "converged" if found.success else "max_iter"
    return watch.result("stopped_early" if watch.idle >= settings.patience else status)


class _Watch:
    """What L-BFGS passes on its way, and the best of it."""

    def __init__(self, objective: Objective, weights: Array, settings: LBFGSSettings) -> None:
        self._objective, self._settings = objective, settings
        self._point = self._best = objective.at(weights)
        self._best_iteration = 0
        self._history = [self._errors(self._point)]
        self.idle = 0

    def cost(self, weights: Array) -> tuple[float, Array]:
        """What is minimised, and its gradient."""
        point = self._point = self._objective.at(weights)
        return point.cost, self._objective.gradient(point)

    def look(self, intermediate_result: OptimizeResult) -> None:
        """Take note of a step; stops where the validation error has not fallen for long."""
        point = self._point
        if not np.array_equal(point.weights, intermediate_result.x):
            point = self._objective.at(intermediate_result.x.copy())
        self._history.append(self._errors(point))
        # Written so that every point is the best where the validation error is NaN.
        notable = (1 - self._settings.min_improvement) * self._best.validation_rms
        self.idle = self.idle + 1 if point.validation_rms >= notable else 0
        if not point.validation_rms >= self._best.validation_rms:
            self._best, self._best_iteration = point, len(self._history) - 1
        if self.idle >= self._settings.patience:
            raise StopIteration

    def result(self, status: Status) -> TrainingResult:
        training_rms, validation_rms = np.array(self._history).T
        return TrainingResult(
            self._best.weights.copy(),
            status,
            len(self._history) - 1,
            self._best_iteration,
            training_rms,
            validation_rms,
        )

    @staticmethod
    def _errors(point: Point) -> tuple[float, float]:
        return point.training_rms, point.validation_rms
