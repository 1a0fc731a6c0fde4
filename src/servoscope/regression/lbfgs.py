"""L-BFGS training of a tanh network, stopped early on validation samples."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.optimize import OptimizeResult, minimize

from servoscope.regression.tanh_network import Array, Objective
from servoscope.regression.training import EarlyStopping, Status, TrainingResult


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
    X, y, weights, X_val, y_val
        As of `levenberg_marquardt`.
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
