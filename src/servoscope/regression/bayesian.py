"""Levenberg-Marquardt training under the weight decay that makes the targets likeliest.

Weights are held to be drawn about zero and targets about the network's output, both normally. All
that the evidence takes of the network is the curvature of its error: the eigenvalues of the
Gauss-Newton matrix ``J'J``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from scipy.linalg import blas, cholesky, eigvalsh, solve_triangular

from servoscope.processes import one_blas_thread
from servoscope.regression.levenberg_marquardt import (
    LMResult,
    LMSettings,
    NormalEquations,
    levenberg_marquardt,
    normal_equations,
)
from servoscope.regression.tanh_network import (
    Array,
    Linearisation,
    activate,
    append_ones,
    linearise,
    split_weights,
)
from servoscope.regression.training import Status


@dataclass(frozen=True, eq=False)
class Evidence:
    """What `n` samples say of a trained network and of its weight decay.

    `cost` is the sum of the squared residuals and of the weight decay times the squared weights;
    `eigenvalues` are those of ``J'J`` that are not zero by count.

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


_LEAST_DAMPING = 1e-3


@dataclass(frozen=True)
class BayesianSettings:
    """How a network is trained:

    the weight decay to start with, too strong rather than too weak; the factor from one to the
    next; how many are tried, and how many without more evidence; and how the network is trained
    under each, from where it stood under the one before.
    """

    weight_decay: float = 10.0
    fall: float = 0.5
    n_decays: int = 24
    patience: int = 4
    steps: LMSettings = field(default_factory=partial(LMSettings, max_iter=20, tol=1e-3))

    def trainer(self, X: Array, hidden: int) -> Callable[..., BayesianResult]:
        """What trains from a start; see `bayesian_lm`."""
        equations = normal_equations(append_ones(X), hidden)
        return partial(bayesian_lm, settings=self, equations=equations)


@dataclass(frozen=True, eq=False)
class BayesianResult(LMResult):
    """What `bayesian_lm` found, and the evidence of the decay that was kept; its history goes on
    from one decay to the next.
    """

    evidence: Evidence

    @property
    def loss(self) -> float:
        """By which the best of several starts is chosen, the least one: minus the evidence."""
        return -self.evidence.log_evidence


def bayesian_lm(
    X: Array,
    y: Array,
    weights: Array,
    X_val: Array | None = None,
    y_val: Array | None = None,
    settings: BayesianSettings | None = None,
    equations: NormalEquations | None = None,
) -> BayesianResult:
    """Train a network as `levenberg_marquardt` does, under the weight decay of the largest
    evidence. Validation samples are taken, so that all ways of training are called alike, and
    ignored.

    Notes
    -----
    In [2]_ the decay is estimated anew after each step, from the effective number of parameters.
    Where there are more weights than samples that runs away to no decay at all and no residuals.
    Here the decay falls from a strong one instead, and the evidence of [1]_ says where to stop.

    References
    ----------
    .. [1] D. MacKay, "Bayesian interpolation", Neural Computation 4 (1992), 415-447.
    .. [2] F. Foresee and M. Hagan, "Gauss-Newton approximation to Bayesian learning", Proc. Int.
       Conf. on Neural Networks (1997), 1930-1935.
    """
    settings = settings or BayesianSettings()
    steps = replace(settings.steps, weight_decay=settings.weight_decay)
    if equations is None:
        inputs = append_ones(X)
        equations = normal_equations(inputs, len(split_weights(weights, inputs.shape[1])[0]))
    tried: list[tuple[LMResult, Evidence]] = []
    best = 0
    for i in range(settings.n_decays):
        found = levenberg_marquardt(X, y, weights, settings=steps, equations=equations)
        weights = found.weights
        tried.append((found, _evidence(X, found, steps.weight_decay)))
        if tried[i][1].log_evidence > tried[best][1].log_evidence:
            best = i
        if i - best >= settings.patience:
            break
        steps = replace(
            steps,
            weight_decay=settings.fall * steps.weight_decay,
            damping=max(float(found.damping[-1]), _LEAST_DAMPING),
        )
    status: Status = "converged" if best < settings.n_decays - 1 else "max_iter"
    return _result(tried, best, status)


def _evidence(X: Array, found: LMResult, weight_decay: float) -> Evidence:
    inputs, weights = append_ones(X), found.weights
    squared_error = len(X) * found.training_rms[-1] ** 2
    return Evidence(
        weight_decay,
        float(squared_error + weight_decay * (weights @ weights)),
        len(X),
        curvature(linearise(weights, inputs, activate(weights, inputs))),
    )


def _result(tried: list[tuple[LMResult, Evidence]], best: int, status: Status) -> BayesianResult:
    """The best of what was tried, with the history of all; each begins where the last ended."""
    found = [result for result, _ in tried]
    begins = [0, *[1] * (len(found) - 1)]
    training_rms = [r.training_rms[begin:] for r, begin in zip(found, begins, strict=True)]
    damping = [r.damping[begin:] for r, begin in zip(found, begins, strict=True)]
    n_iter = sum(r.n_iter for r in found)
    return BayesianResult(
        found[best].weights,
        status,
        n_iter,
        sum(r.n_iter for r in found[: best + 1]),
        np.concatenate(training_rms),
        np.full(n_iter + 1, np.nan),
        np.concatenate(damping),
        tried[best][1],
    )


@dataclass(frozen=True, eq=False)
class WeightPosterior:
    """Laplace's approximation about trained weights, for the inputs (n, k) they were trained on.

    `noise` is the standard deviation of targets about the network's output.

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
