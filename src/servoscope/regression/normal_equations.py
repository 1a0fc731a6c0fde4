"""The damped normal equations of a network, solved over its weights or over its samples.

A Levenberg-Marquardt step ``s`` with damping ``mu`` and weight decay ``w`` solves

    (J'J + lam I) s = J'e - w theta,    lam = mu + w,

a system over the weights (primal). Over the samples (dual) it reads

    s = J'a - (w / lam) theta,    (JJ' + lam I) a = e + (w / lam) J theta,

and with one output ``JJ' = (D D') o (Z Z') + A A'`` (o elementwise), so that J is never written
out and the cost is the same for any number of inputs.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import DTypeLike, NDArray
from scipy.linalg.blas import get_blas_funcs
from scipy.linalg.lapack import get_lapack_funcs

from servoscope.regression.tanh_network import Array, Linearisation, count_weights


class NormalEquations(Protocol):
    """A way to solve for the step."""

    def linearise(self, linearisation: Linearisation) -> None:
        """Take the derivatives that the next steps start from."""

    def step(
        self, residuals: Array, weights: Array, damping: float, weight_decay: float
    ) -> Array | None:
        """The change of the weights, or None where the matrix is not positive definite."""


class _Cholesky:
    """Solves a damped symmetric system, of which one triangle is given, in place of a copy."""

    def __init__(self, size: int, dtype: DTypeLike) -> None:
        self.matrix = np.zeros((size, size), dtype, order="F")
        self._factor = np.empty_like(self.matrix)
        self.syrk = get_blas_funcs("syrk", (self.matrix,))
        self._potrf, self._potrs = get_lapack_funcs(("potrf", "potrs"), (self.matrix,))

    def solve(self, right: Array, damping: float) -> Array | None:
        np.copyto(self._factor, self.matrix)
        self._factor.ravel(order="K")[:: len(right) + 1] += damping
        factor, info = self._potrf(self._factor, lower=1, overwrite_a=1, clean=0)
        if info:
            return None
        solution, _ = self._potrs(factor, right.astype(factor.dtype), lower=1, overwrite_b=1)
        return solution.astype(np.float64)


class DualEquations:
    """The system over the samples."""

    def __init__(self, inputs: Array, dtype: DTypeLike = np.float32) -> None:
        n = len(inputs)
        self._system = _Cholesky(n, dtype)
        self._input_gram = np.zeros((n, n), dtype, order="F")
        self._syrk(inputs, 0.0, self._input_gram)

    def linearise(self, linearisation: Linearisation) -> None:
        self._linearisation = linearisation
        gram = self._system.matrix
        self._syrk(linearisation.slopes, 0.0, gram)
        gram *= self._input_gram
        self._syrk(linearisation.activations, 1.0, gram)

    def step(
        self, residuals: Array, weights: Array, damping: float, weight_decay: float
    ) -> Array | None:
        J = self._linearisation
        if not weight_decay:
            solution = self._system.solve(residuals, damping)
            return None if solution is None else J.transposed_times(solution)
        total = damping + weight_decay
        share = weight_decay / total
        solution = self._system.solve(residuals + share * J.times(weights), total)
        return None if solution is None else J.transposed_times(solution) - share * weights

    def _syrk(self, rows: Array, beta: float, out: NDArray) -> None:
        """Lower triangle of ``rows rows' + beta out``, in place."""
        rows = np.asfortranarray(rows, dtype=out.dtype)
        self._system.syrk(1.0, rows, beta=beta, c=out, overwrite_c=1, lower=1)


class PrimalEquations:
    """The system over the weights."""

    def __init__(self, inputs: Array, hidden: int, dtype: DTypeLike = np.float32) -> None:
        n, n_inputs = inputs.shape
        n_weights = count_weights(n_inputs - 1, hidden)
        self._system = _Cholesky(n_weights, dtype)
        self._jacobian = np.empty((n, n_weights), dtype)
        self._hidden = self._jacobian[:, : hidden * n_inputs].reshape(n, hidden, n_inputs)
        self._inputs = inputs.astype(dtype)

    def linearise(self, linearisation: Linearisation) -> None:
        self._linearisation = linearisation
        slopes = linearisation.slopes.astype(self._jacobian.dtype)
        np.multiply(slopes[:, :, None], self._inputs[:, None, :], out=self._hidden)
        self._jacobian[:, -linearisation.activations.shape[1] :] = linearisation.activations
        self._system.syrk(1.0, self._jacobian.T, c=self._system.matrix, overwrite_c=1, lower=1)

    def step(
        self, residuals: Array, weights: Array, damping: float, weight_decay: float
    ) -> Array | None:
        descent = self._linearisation.transposed_times(residuals) - weight_decay * weights
        return self._system.solve(descent, damping + weight_decay)


def normal_equations(
    inputs: Array, hidden: int, dtype: DTypeLike = np.float32
) -> DualEquations | PrimalEquations:
    """The form that costs fewer operations for these inputs and number of hidden units."""
    n, n_inputs = inputs.shape
    n_weights = count_weights(n_inputs - 1, hidden)
    dual = 2 * hidden * n**2 + n**3 / 3
    primal = n * n_weights**2 + n_weights**3 / 3
    return DualEquations(inputs, dtype) if dual < primal else PrimalEquations(inputs, hidden, dtype)
