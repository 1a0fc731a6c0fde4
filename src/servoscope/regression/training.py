"""A network trained from several starts on standardised samples."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from servoscope.processes import one_blas_thread
from servoscope.regression.levenberg_marquardt import LMResult, LMSettings, levenberg_marquardt
from servoscope.regression.normal_equations import normal_equations
from servoscope.regression.tanh_network import (
    Array,
    append_ones,
    count_weights,
    evaluate,
    initial_weights,
)


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
    """The best of some training runs, with the scales it works in.

    Attributes
    ----------
    weights : ndarray of shape (n_weights,)
    inputs, target : Standardisation
    results : tuple of LMResult
        One for each start, errors in units of the target.
    best : int
        Which of them gave the weights.
    """

    weights: Array
    inputs: Standardisation
    target: Standardisation
    results: tuple[LMResult, ...] = ()
    best: int = 0

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
    settings: LMSettings,
) -> TrainedNetwork:
    """Train from `restarts` random starts and keep the start with the least `best_rms`.

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
        equations = normal_equations(append_ones(X), hidden)
        results = [
            levenberg_marquardt(X, y, start, X_val, y_val, settings, equations) for start in starts
        ]
    best = int(np.argmin([result.best_rms for result in results]))
    scaled = tuple(_rescale(result, 1.0 / float(target.scale)) for result in results)
    return TrainedNetwork(results[best].weights, inputs, target, scaled, best)


def _starts(n_features: int, hidden: int, restarts: int, seed: int) -> Iterator[Array]:
    for restart in range(restarts):
        yield initial_weights(n_features, hidden, np.random.default_rng([seed, restart]))


def _rescale(result: LMResult, factor: float) -> LMResult:
    return replace(
        result,
        training_rms=result.training_rms * factor,
        validation_rms=result.validation_rms * factor,
    )
