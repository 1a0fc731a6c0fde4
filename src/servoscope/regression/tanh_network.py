"""A k-h-1 network of tanh hidden units and one linear output, its derivatives, and its error.

Inputs and hidden activations carry a last column of ones, so that biases are weights like any
other: with the inputs ``Z = [X, 1]``, hidden weights ``W`` of shape (h, k + 1) and output weights
``v`` of shape (h + 1,), the activations are ``A = [tanh(Z W'), 1]`` and the output is ``A v``. All
weights stand in one vector, ``[W.ravel(), v]``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Linearisation(NamedTuple):
    """What the Jacobian of the output by the weights, (n, n_weights), is made of.

    Row ``i`` of the Jacobian is ``[kron(slopes[i], inputs[i]), activations[i]]``; it is seldom
    worth writing out.
    """

    inputs: Array
    """Z, of shape (n, k + 1)."""
    slopes: Array
    """Derivatives of the output by the sum that enters each hidden unit, (n, h)."""
    activations: Array
    """A, of shape (n, h + 1)."""

    def jacobian(self) -> Array:
        """The Jacobian itself, (n, n_weights)."""
        n = len(self.inputs)
        hidden = (self.slopes[:, :, None] * self.inputs[:, None, :]).reshape(n, -1)
        return np.hstack([hidden, self.activations])

    def times(self, direction: Array) -> Array:
        """The Jacobian times a vector of weights, (n,)."""
        W, v = split_weights(direction, self.inputs.shape[1])
        return np.einsum("ij,ij->i", self.inputs @ W.T, self.slopes) + self.activations @ v

    def transposed_times(self, residuals: Array) -> Array:
        """The transposed Jacobian times one value a sample, (n_weights,)."""
        hidden = (self.slopes * residuals[:, None]).T @ self.inputs
        return np.concatenate([hidden.ravel(), residuals @ self.activations])


def append_ones(X: Array) -> Array:
    """`X` with a last column of ones."""
    inputs = np.ones((len(X), X.shape[1] + 1))
    inputs[:, :-1] = X
    return inputs


def count_weights(n_features: int, hidden: int) -> int:
    """Number of weights of a network, biases included."""
    return hidden * (n_features + 2) + 1


def split_weights(weights: Array, n_inputs: int) -> tuple[Array, Array]:
    """Hidden weights (h, n_inputs) and output weights (h + 1,), as views."""
    n_hidden_weights = (weights.size - 1) // (n_inputs + 1) * n_inputs
    return weights[:n_hidden_weights].reshape(-1, n_inputs), weights[n_hidden_weights:]


def activate(weights: Array, inputs: Array) -> Array:
    """Hidden activations with their column of ones, (n, h + 1)."""
    W, _ = split_weights(weights, inputs.shape[1])
    activations = np.ones((len(inputs), len(W) + 1))
    np.tanh(inputs @ W.T, out=activations[:, :-1])
    return activations


def evaluate(weights: Array, inputs: Array) -> Array:
    """The network's output, (n,), for inputs that carry their column of ones."""
    _, v = split_weights(weights, inputs.shape[1])
    return activate(weights, inputs) @ v


def linearise(weights: Array, inputs: Array, activations: Array) -> Linearisation:
    """The derivatives at `weights`, where `activate` gave `activations`."""
    _, v = split_weights(weights, inputs.shape[1])
    return Linearisation(inputs, (1.0 - activations[:, :-1] ** 2) * v[:-1], activations)


def initial_weights(n_features: int, hidden: int, rng: np.random.Generator) -> Array:
    """Random weights for inputs and a target of zero mean and unit variance.

    The units start nearly linear, each about another point of its tanh, the more so the more
    inputs there are. Larger starts over-fit: with 65 inputs whose weighted sum has unit variance,
    the error on new samples was half as large again.
    """
    W = rng.normal(0.0, 1.0 / n_features, (hidden, n_features))
    b = rng.normal(0.0, 1.0, (hidden, 1))
    v = rng.normal(0.0, 0.3, hidden)
    return np.concatenate([np.hstack([W, b]).ravel(), v, [0.0]])


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
