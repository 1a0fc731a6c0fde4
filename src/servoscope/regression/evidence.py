"""How likely the targets are under a weight decay, seen from where training has ended.

Weights are held to be drawn about zero and targets about the network's output, both normally. All
that this takes of the network is the curvature of its error: the eigenvalues of the Gauss-Newton
matrix ``J'J``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import blas, eigvalsh

from servoscope.regression.tanh_network import Array, Linearisation


@dataclass(frozen=True, eq=False)
class Evidence:
    """What the samples say of a trained network and of its weight decay.

    Parameters
    ----------
    weight_decay : float
        Under which the network was trained.
    cost : float
        Sum of the squared residuals, and the weight decay times the squared weights.
    n : int
        Number of samples.
    eigenvalues : ndarray
        Of ``J'J``, those that are not zero by count.

    Notes
    -----
    The weight decay is alpha / beta of [1]_, and the variance of the noise, 1 / beta, is the one
    that makes the targets likeliest, ``cost / n``.

    References
    ----------
    .. [1] D. MacKay, "Bayesian interpolation", Neural Computation 4 (1992), 415-447.

    Examples
    --------
    >>> evidence = Evidence(1.0, cost=0.48, n=12, eigenvalues=np.array([1e9, 1.0, 0.0]))
    >>> round(evidence.effective_parameters, 6), round(evidence.noise, 6)
    (1.5, 0.2)
    """

    weight_decay: float
    cost: float
    n: int
    eigenvalues: Array

    @property
    def effective_parameters(self) -> float:
        """How many weights the samples decide on, and not the decay."""
        return float(np.sum(self.eigenvalues / (self.eigenvalues + self.weight_decay)))

    @property
    def noise(self) -> float:
        """Standard deviation of the target about the network's output."""
        return float(np.sqrt(self.cost / self.n))

    @property
    def log_evidence(self) -> float:
        """Logarithm of the density of the targets, up to a constant that n alone decides."""
        if not self.cost:
            return float(np.inf)
        volume = np.sum(np.log1p(self.eigenvalues / self.weight_decay))
        return float(-self.n * np.log(self.noise) - 0.5 * volume)


def curvature(linearisation: Linearisation) -> Array:
    """Eigenvalues of ``J'J``, all but zeros, from the smaller one of ``J'J`` and ``JJ'``."""
    n, hidden = linearisation.slopes.shape
    n_weights = hidden * linearisation.inputs.shape[1] + hidden + 1
    if n_weights <= n:
        gram = blas.dsyrk(1.0, linearisation.jacobian(), trans=1, lower=1)
    else:
        gram = linearisation.slopes @ linearisation.slopes.T
        gram *= linearisation.inputs @ linearisation.inputs.T
        gram += linearisation.activations @ linearisation.activations.T
    return np.maximum(eigvalsh(gram, lower=True, overwrite_a=True, check_finite=False), 0.0)
