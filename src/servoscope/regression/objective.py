"""What training minimises, and what it watches meanwhile."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from servoscope.regression.tanh_network import (
    Array,
    Linearisation,
    activate,
    append_ones,
    linearise,
    split_weights,
)


class Point(NamedTuple):
    """The network at some weights."""

    weights: Array
    activations: Array
    """Of the training samples, (n, h + 1)."""
    residuals: Array
    """Of the training samples, (n,)."""
    cost: float
    """Sum of the squared residuals, and the weight decay times the squared weights."""
    training_rms: float
    validation_rms: float
    """NaN without validation samples."""


class Objective:
    """The error of a network on training samples, and on validation samples if there are any."""

    def __init__(
        self, X: Array, y: Array, X_val: Array | None, y_val: Array | None, weight_decay: float
    ) -> None:
        self._inputs = append_ones(X if X_val is None else np.vstack([X, X_val]))
        self._targets = y if y_val is None else np.concatenate([y, y_val])
        self._n_train = len(y)
        self._weight_decay = weight_decay

    @property
    def training_inputs(self) -> Array:
        """Inputs of the training samples with their column of ones, (n, k + 1)."""
        return self._inputs[: self._n_train]

    def at(self, weights: Array) -> Point:
        """The network at `weights`."""
        n = self._n_train
        activations = activate(weights, self._inputs)
        _, v = split_weights(weights, self._inputs.shape[1])
        errors = self._targets - activations @ v
        residuals = errors[:n]
        cost = float(residuals @ residuals + self._weight_decay * (weights @ weights))
        return Point(weights, activations[:n], residuals, cost, _rms(residuals), _rms(errors[n:]))

    def linearise(self, point: Point) -> Linearisation:
        """The derivatives of the output at the training samples."""
        return linearise(point.weights, self.training_inputs, point.activations)

    def gradient(self, point: Point) -> Array:
        """The derivatives of the cost by the weights, (n_weights,)."""
        descent = self.linearise(point).transposed_times(point.residuals)
        return 2 * (self._weight_decay * point.weights - descent)


def _rms(errors: Array) -> float:
    return float(np.sqrt(errors @ errors / len(errors))) if len(errors) else np.nan
