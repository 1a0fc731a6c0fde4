"""Levenberg-Marquardt training of a tanh network, stopped early on validation samples.

A step ``s`` with damping ``mu`` and weight decay ``w`` solves

    (J'J + lam I) s = J'e - w theta,    lam = mu + w,

a system over the weights (primal). Over the samples (dual) it reads

    s = J'a - (w / lam) theta,    (JJ' + lam I) a = e + (w / lam) J theta,

and with one output ``JJ' = (D D') o (Z Z') + A A'`` (o elementwise), so that J is never written
out and the cost is the same for any number of inputs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import DTypeLike, NDArray
from scipy.linalg.blas import get_blas_funcs
from scipy.linalg.lapack import get_lapack_funcs

from servoscope.regression.tanh_network import (
    Array,
    Linearisation,
    Objective,
    Point,
    append_ones,
    count_weights,
    split_weights,
)
from servoscope.regression.training import EarlyStopping, Status, TrainingResult

_SAFETY = 4.0
"""How many times the rounding of its largest eigenvalue the damping of a matrix must be."""


class Step(NamedTuple):
    """A change of the weights, and how steeply what is minimised falls along it."""

    change: Array
    slope: float
    """``change' (J'e - w theta)``"""


class NormalEquations(Protocol):
    """A way to solve for the step."""

    def linearise(self, linearisation: Linearisation) -> None:
        """Take the derivatives that the next steps start from."""

    def step(
        self, residuals: Array, weights: Array, damping: float, weight_decay: float
    ) -> Step | None:
        """The step, or None where rounding leaves the matrix not positive definite."""


class _DampedSystem:
    """A symmetric matrix, of which the lower triangle is kept, and its damped solutions."""

    def __init__(self, size: int, dtype: DTypeLike) -> None:
        self.matrix = np.zeros((size, size), dtype, order="F")
        self._factor = np.empty_like(self.matrix)
        self._syrk, self._trsv = get_blas_funcs(("syrk", "trsv"), (self.matrix,))
        self._potrf = get_lapack_funcs("potrf", (self.matrix,))

    def fill(self, rows: NDArray) -> None:
        """Make the matrix ``rows rows'``."""
        self._syrk(1.0, rows, beta=0.0, c=self.matrix, overwrite_c=1, lower=1)

    def add(self, rows: NDArray) -> None:
        """Add ``rows rows'`` to the matrix."""
        self._syrk(1.0, rows, beta=1.0, c=self.matrix, overwrite_c=1, lower=1)

    def trace(self) -> float:
        """Sum of the diagonal, which no eigenvalue exceeds."""
        return float(np.trace(self.matrix))

    def solve(self, right: Array, damping: float) -> Array | None:
        """The solution with `damping` on the diagonal; None where rounding leaves none."""
        np.copyto(self._factor, self.matrix)
        self._factor.ravel(order="K")[:: len(right) + 1] += damping
        factor, info = self._potrf(self._factor, lower=1, overwrite_a=1, clean=0)
        if info:
            return None
        # Two triangular solves: for one right side potrs takes five times as long.
        half = self._trsv(factor, right.astype(factor.dtype), lower=1)
        return self._trsv(factor, half, lower=1, trans=1).astype(np.float64)


class DualEquations:
    """The system over the samples."""

    def __init__(self, inputs: Array, dtype: DTypeLike = np.float32) -> None:
        self._system = _DampedSystem(len(inputs), dtype)
        self._dtype = dtype
        self._system.fill(np.asfortranarray(inputs, dtype))
        self._input_gram = self._system.matrix.copy(order="F")

    def linearise(self, linearisation: Linearisation) -> None:
        """Take the derivatives that the next steps start from."""
        self._linearisation = linearisation
        self._system.fill(np.asfortranarray(linearisation.slopes, self._dtype))
        self._system.matrix *= self._input_gram
        self._system.add(np.asfortranarray(linearisation.activations, self._dtype))

    def trace(self) -> float:
        """Trace of the system's matrix."""
        return self._system.trace()

    def step(
        self, residuals: Array, weights: Array, damping: float, weight_decay: float
    ) -> Step | None:
        J, total = self._linearisation, damping + weight_decay
        share = weight_decay / total
        right = residuals + share * J.times(weights) if share else residuals
        solution = self._system.solve(right, total)
        if solution is None:
            return None
        change = J.transposed_times(solution) - share * weights
        # J change = e - lam a, as the second form shows when J s is written out.
        slope = residuals @ (residuals - total * solution) - weight_decay * (change @ weights)
        return Step(change, float(slope))


class PrimalEquations:
    """The system over the weights."""

    def __init__(self, inputs: Array, hidden: int, dtype: DTypeLike = np.float32) -> None:
        n, n_inputs = inputs.shape
        n_weights = count_weights(n_inputs - 1, hidden)
        self._system = _DampedSystem(n_weights, dtype)
        self._jacobian = np.empty((n, n_weights), dtype)
        self._hidden = self._jacobian[:, : hidden * n_inputs].reshape(n, hidden, n_inputs)
        self._inputs = inputs.astype(dtype)

    def linearise(self, linearisation: Linearisation) -> None:
        self._linearisation = linearisation
        slopes = linearisation.slopes.astype(self._jacobian.dtype)
        np.multiply(slopes[:, :, None], self._inputs[:, None, :], out=self._hidden)
        self._jacobian[:, -linearisation.activations.shape[1] :] = linearisation.activations
        self._system.fill(self._jacobian.T)

    def trace(self) -> float:
        """Trace of the system's matrix."""
        return self._system.trace()

    def step(
        self, residuals: Array, weights: Array, damping: float, weight_decay: float
    ) -> Step | None:
        descent = self._linearisation.transposed_times(residuals) - weight_decay * weights
        change = self._system.solve(descent, damping + weight_decay)
        return None if change is None else Step(change, float(change @ descent))


class MixedPrecision:
    """Single precision, and double for dampings that single precision would round away.

    Parameters
    ----------
    form : callable
        Makes the equations in a given precision.
    """

    def __init__(self, form: Callable[[DTypeLike], DualEquations | PrimalEquations]) -> None:
        self._form = form
        self._single = form(np.float32)
        self._double: DualEquations | PrimalEquations | None = None
        self._double_is_current = False

    def linearise(self, linearisation: Linearisation) -> None:
        """Take the derivatives that the next steps start from."""
        self._linearisation = linearisation
        self._single.linearise(linearisation)
        self._double_is_current = False

    def step(
        self, residuals: Array, weights: Array, damping: float, weight_decay: float
    ) -> Step | None:
        """The step, in the precision that the damping needs."""
        equations: NormalEquations = self._single
        if damping + weight_decay < _SAFETY * np.finfo(np.float32).eps * self._single.trace():
            equations = self._in_double()
        return equations.step(residuals, weights, damping, weight_decay)

    def _in_double(self) -> NormalEquations:
        if self._double is None:
            self._double = self._form(np.float64)
        if not self._double_is_current:
            self._double.linearise(self._linearisation)
            self._double_is_current = True
        return self._double


def normal_equations(inputs: Array, hidden: int) -> MixedPrecision:
    """The form that costs fewer operations for these inputs and number of hidden units."""
    n, n_inputs = inputs.shape
    n_weights = count_weights(n_inputs - 1, hidden)
    dual = 2 * hidden * n**2 + n**3 / 3
    primal = n * n_weights**2 + n_weights**3 / 3
    if dual < primal:
        return MixedPrecision(partial(DualEquations, inputs))
    return MixedPrecision(partial(PrimalEquations, inputs, hidden))


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
    """What `levenberg_marquardt` found, with the damping of each step, the starting one first."""

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

    Inputs (n, k) and target (n,) are of about unit scale; validation samples, if any, stop the
    training and choose its best iteration. `equations` are made for ``X`` with its column of ones;
    by default they are the cheaper of primal and dual form, in single precision. Residuals and
    weights are always in double precision.

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
