"""Levenberg-Marquardt training of a tanh network, stopped early on validation samples."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from servoscope.regression.normal_equations import NormalEquations, normal_equations
from servoscope.regression.tanh_network import Array, Objective, Point, append_ones, split_weights
from servoscope.regression.training import EarlyStopping, Status, TrainingResult

_DAMPING_FALL, _DAMPING_RISE = 0.5, 3.0
_TRUSTED_GAIN = 0.75
_DAMPING_LIMITS = 1e-6, 1e10


@dataclass(frozen=True)
class LMSettings:
    """How a network is trained.

    Parameters
    ----------
    max_iter : int
        Most steps taken.
    patience : int
        Steps without a notably lower validation error after which training stops.
    damping : float
        The damping to start with, in units of the squared target summed over the samples.
    weight_decay : float
        Factor of the squared weights in what is minimised, the squared residuals summed over
        the samples plus ``weight_decay`` times the squared weights.
    min_improvement : float
        Relative fall of the validation error that counts as notable.
    tol : float
        Relative fall of what is minimised below which a step counts as no progress.
    """

    max_iter: int = 200
    patience: int = 3
    damping: float = 10.0
    weight_decay: float = 0.0
    min_improvement: float = 0.005
    tol: float = 1e-6

    def trainer(self, X: Array, hidden: int) -> Callable[..., LMResult]:
        """What trains from a start; see `levenberg_marquardt`."""
        equations = normal_equations(append_ones(X), hidden)
        return partial(levenberg_marquardt, settings=self, equations=equations)


@dataclass(frozen=True, eq=False)
class LMResult(TrainingResult):
    """What `levenberg_marquardt` found.

    Attributes
    ----------
    damping : ndarray of shape (n_iter + 1,)
        Damping of each step; the starting one comes first.
    """

    damping: NDArray[np.float64]


def levenberg_marquardt(
    X: Array,
    y: Array,
    weights: Array,
    X_val: Array | None = None,
    y_val: Array | None = None,
    settings: LMSettings | None = None,
    equations: NormalEquations | None = None,
) -> LMResult:
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
    settings : LMSettings, optional
    equations : NormalEquations, optional
        Made for ``X`` with its column of ones; by default the cheaper of primal and dual form,
        in single precision. Residuals and weights are always in double precision.

    Returns
    -------
    LMResult

    Notes
    -----
    The damping is halved after a step that lowers the cost by at least three quarters of what the
    linearised network foretells, and tripled after one that does not lower it, which is undone.

    References
    ----------
    Marquardt, D.: An algorithm for least-squares estimation of nonlinear parameters, J. SIAM 11
    (1963), 431-441. Hagan, M. and Menhaj, M.: Training feedforward networks with the Marquardt
    algorithm, IEEE Trans. Neural Networks 5 (1994), 989-993.
    """
    settings = settings or LMSettings()
    objective = Objective(X, y, X_val, y_val, settings.weight_decay)
    if equations is None:
        hidden = len(split_weights(weights, X.shape[1] + 1)[0])
        equations = normal_equations(objective.training_inputs, hidden)
    point, damping = objective.at(weights), settings.damping
    stopping = EarlyStopping(point, settings.patience, settings.min_improvement)
    dampings = [damping]
    status: Status | None = None
    while status is None:
        advance = _descend(objective, equations, point, damping, settings.weight_decay)
        if advance is None:
            status = "damping_limit"
            break
        relative_fall = 1.0 - advance.point.cost / point.cost
        point, damping = advance.point, advance.next_damping
        stopping.note(point)
        dampings.append(advance.damping)
        if stopping.is_over:
            status = "stopped_early"
        elif relative_fall <= settings.tol:
            status = "converged"
        elif stopping.n_iter >= settings.max_iter:
            status = "max_iter"
    return LMResult(**vars(stopping.result(status)), damping=np.array(dampings))


class _Advance(NamedTuple):
    """Where a step led, the damping it was taken with, and the one to go on with."""

    point: Point
    damping: float
    next_damping: float


def _descend(
    objective: Objective,
    equations: NormalEquations,
    point: Point,
    damping: float,
    weight_decay: float,
) -> _Advance | None:
    """A step that lowers the cost; None if no damping gives one."""
    equations.linearise(objective.linearise(point))
    while damping <= _DAMPING_LIMITS[1]:
        step = equations.step(point.residuals, point.weights, damping, weight_decay)
        if step is not None:
            trial = objective.at(point.weights + step.change)
            fall = point.cost - trial.cost
            foreseen = damping * (step.change @ step.change) + step.slope
            if fall > 0:
                factor = _DAMPING_FALL if fall > _TRUSTED_GAIN * foreseen else 1.0
                return _Advance(trial, damping, max(factor * damping, _DAMPING_LIMITS[0]))
        damping *= _DAMPING_RISE
    return None
