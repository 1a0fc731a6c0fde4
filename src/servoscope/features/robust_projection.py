"""What most of a set of values says that they should be, the rest being out of the ordinary."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, lapack, svd

from servoscope.processes import one_blas_thread

Array = NDArray[np.float64]

_SCALE_DEVIATION = 0.3
_BLOCK = 50


@dataclass(frozen=True, eq=False)
class RobustProjection:
    """Projection onto the leading eigenvectors by what is not out of the ordinary.

    Parameters
    ----------
    mean : ndarray of shape (n_values,)
    components : ndarray of shape (n_components, n_values)
        Eigenvectors, each as long as its projections deviate in training.
    nuisances : ndarray of shape (n_nuisances, n_values)
        What else values may change by, of a standard deviation.
    noise : ndarray of shape (n_values,)
        Standard deviation of what the eigenvectors leave of training values.
    n_layers : int
        Values are of the shape (n_layers, n_places), flattened.

    Notes
    -----
    Values are modelled as ``a (mean + u E) + v N + noise`` with ``u`` and ``v`` standard normal
    and ``a`` of standard deviation 0.3 about 1, and the most probable ``a``, ``u`` and ``v`` are
    found by iteratively reweighted least squares. Places count by the weight of Geman and McClure
    ``(t^2 / (t^2 + r^2))^2``, ``r^2`` being the mean squared residual of their layers in units of
    the noise and ``t`` a scale that shrinks from one iteration to the next, as in [1]_ and [2]_;
    so all layers of a place drop out together.

    References
    ----------
    .. [1] M. J. Black and A. D. Jepson, "EigenTracking: robust matching and tracking of
       articulated objects using a view-based representation", International Journal of Computer
       Vision 26 (1998), 63-84.
    .. [2] A. Leonardis and H. Bischof, "Robust recognition using eigenimages", Computer Vision and
       Image Understanding 78 (2000), 99-118.
    """

    mean: Array
    components: Array
    nuisances: Array
    noise: Array
    n_layers: int

    def complete(
        self, values: Array, scales: Sequence[float], weights: Array | None = None
    ) -> tuple[Array, Array]:
        """Values as the eigenvectors have them, and how much each place counts in that.

        Parameters
        ----------
        values : ndarray of shape (n, n_values)
        scales : sequence of float
            ``t`` of each iteration.
        weights : ndarray of shape (n, n_places), optional
            To begin with; all 1 by default.

        Returns
        -------
        completed : ndarray of shape (n, n_values)
        weights : ndarray of shape (n, n_places)
        """
        n_places = len(self.mean) // self.n_layers
        weights = np.ones((len(values), n_places)) if weights is None else weights.copy()
        completed = np.empty_like(values)
        with one_blas_thread():
            for start in range(0, len(values), _BLOCK):
                block = slice(start, start + _BLOCK)
                for scale in scales:
                    solution = self._solve(values[block], weights[block])
                    residuals = values[block] / self.noise - solution @ self._design
                    squares = np.square(residuals).reshape(-1, self.n_layers, n_places).mean(axis=1)
                    weights[block] = (scale**2 / (scale**2 + squares)) ** 2
                completed[block] = self._without_nuisances(solution)
        return completed, weights

    def __getstate__(self) -> dict[str, Any]:
        """Without what follows from the fields, which takes more room than they do."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @cached_property
    def _design(self) -> Array:
        """What values are a sum of, in units of the noise."""
        rows = np.vstack([_SCALE_DEVIATION * self.mean, self.components, self.nuisances])
        return rows / self.noise

    @cached_property
    def _grams(self) -> Array:
        """Inner products of the rows of the design in each place, a row of a triangle each."""
        by_place = self._design.reshape(len(self._design), self.n_layers, -1).transpose(2, 0, 1)
        rows, columns = np.triu_indices(len(self._design))
        return np.array([(place @ place.T)[rows, columns] for place in by_place])

    def _solve(self, values: Array, weights: Array) -> Array:
        n_rows = len(self._design)
        expected = np.zeros(n_rows)
        expected[0] = 1 / _SCALE_DEVIATION
        weighted = values / self.noise * np.tile(weights, self.n_layers)
        right = weighted @ self._design.T + expected
        left = np.zeros((len(values), n_rows, n_rows))
        packed, start = weights @ self._grams, 0
        for i in range(n_rows):
            left[:, i, i:] = packed[:, start : start + n_rows - i]
            start += n_rows - i
        left[:, np.arange(n_rows), np.arange(n_rows)] += 1
        return np.array([_solve_positive(*system) for system in zip(left, right, strict=True)])

    def _without_nuisances(self, solution: Array) -> Array:
        """``mean + u E`` of solutions, ``a`` being kept away from 0."""
        factor = np.maximum(_SCALE_DEVIATION * solution[:, :1], 0.1)
        return self.mean + solution[:, 1 : 1 + len(self.components)] / factor @ self.components


def fit_robust_projection(
    values: Array, n_layers: int, n_components: int, nuisances: Array
) -> RobustProjection:
    """The `RobustProjection` of training values.

    Parameters
    ----------
    values : ndarray of shape (n, n_layers * n_places)
    n_layers : int
    n_components : int
        Less than n; fewer are used where values do not vary in as many directions.
    nuisances : ndarray of shape (n_nuisances, n_layers * n_places)
    """
    n = len(values)
    mean = values.mean(axis=0)
    with one_blas_thread():
        _, lengths, vectors = svd(values - mean, full_matrices=False)
        n_components = min(n_components, int((lengths > 1e-9 * lengths[0]).sum()))
        vectors = vectors[:n_components]
        left = values - mean - (values - mean) @ vectors.T @ vectors
    variances = (left**2).sum(axis=0) / (n - n_components)
    rounding = 1e-6 * float(np.square(values).mean()) or 1.0
    noise = np.sqrt(variances + np.median(variances) + rounding)
    components = vectors * (lengths[:n_components, None] / np.sqrt(n))
    return RobustProjection(mean, components, nuisances, noise, n_layers)


def _solve_positive(left: Array, right: Array) -> Array:
    """The solution by the upper triangle of `left`, which is overwritten."""
    _, solution, info = lapack.dposv(left.T, right, lower=1, overwrite_a=1)
    if info != 0:
        raise LinAlgError("The normal equations are not positive definite.")
    return solution
