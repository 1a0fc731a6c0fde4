"""How far the samples leave a network's weights open, and its output with them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from servoscope.processes import one_blas_thread
from servoscope.regression.tanh_network import (
    Array,
    Linearisation,
    activate,
    append_ones,
    linearise,
)


@dataclass(frozen=True, eq=False)
class WeightPosterior:
    """Laplace's approximation about trained weights.

    Parameters
    ----------
    weights : ndarray of shape (n_weights,)
    X : ndarray of shape (n, k)
        Inputs that the network was trained on, as it takes them.
    weight_decay : float
        Under which it was trained.
    noise : float
        Standard deviation of targets about the network's output.

    Notes
    -----
    With J the Jacobian at the training samples and j at a new one, the variance of a new target
    is ``noise^2 (1 + j' (J'J + weight_decay I)^-1 j)`` [1]_.

    References
    ----------
    .. [1] D. MacKay, "A practical Bayesian framework for backpropagation networks", Neural
       Computation 4 (1992), 448-472.
    """

    weights: Array
    X: Array
    weight_decay: float
    noise: float
    _factor: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        J = self._linearise(self.X).jacobian()
        with one_blas_thread():
            precision = J.T @ J
            precision[np.diag_indices_from(precision)] += self.weight_decay
            factor = cholesky(precision, lower=True, overwrite_a=True, check_finite=False)
        object.__setattr__(self, "_factor", factor)

    def deviation(self, X: Array) -> Array:
        """Standard deviation of a target at inputs X, (n,)."""
        J = self._linearise(X).jacobian()
        open_ = solve_triangular(self._factor, J.T, lower=True, check_finite=False)
        return self.noise * np.sqrt(1 + np.einsum("ij,ij->j", open_, open_))

    def _linearise(self, X: Array) -> Linearisation:
        inputs = append_ones(X)
        return linearise(self.weights, inputs, activate(self.weights, inputs))
