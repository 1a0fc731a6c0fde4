"""A model of features as one graph: features, a regressor for each dof, and what is expected."""

from __future__ import annotations

from typing import Any

import numpy as np

from servoscope.dofs import mask_of
from servoscope.errors import ModelError
from servoscope.export.graph import Graph, Value, concatenate, maximum, stack, where
from servoscope.export.image_features import features_of
from servoscope.export.rigid import about_pivot, inverse
from servoscope.poses import inverse_transform, rigid_transform
from servoscope.positioning.feature_model import FARTHEST, NEAR, FeatureModel
from servoscope.regression.kernel_regressors import KernelRegressor
from servoscope.regression.network_regressors import BayesianLMRegressor, NetworkRegressor
from servoscope.regression.tanh_network import split_weights


def estimate_of_features(graph: Graph, model: FeatureModel, image: Value) -> dict[str, Value]:
    """What a model of features says of an image, by name.

    Parameters
    ----------
    graph : Graph
    model : FeatureModel
    image : Value of shape (height, width), uint8

    Raises
    ------
    ModelError
        If its features or regressors have no ONNX form.
    """
    pipeline, is_read = model.pipeline, mask_of(model.dofs)
    grey, reach = image.cast(np.float64), model.reach[is_read]
    X = concatenate(
        [features_of(one.transformer, name, grey) for name, one in pipeline.fitted_.items()]
    )
    means, deviations = [], []
    for one, scale in zip(pipeline.regressors_.values(), pipeline.ranges_, strict=True):
        mean, deviation = _predicted(one.regressor, X.take(one.columns.astype(np.int64)))
        means.append(mean * float(scale))
        deviations.append(deviation * float(scale))
    n = len(means)
    mean, deviation = stack(means, n), stack(deviations, n) * model.std_factor
    away = graph.apply("Abs", mean - model.at_reference) / reach
    nearness = graph.apply("Exp", -0.5 * (away.max() / NEAR) * (away.max() / NEAR))
    spread = np.eye(6)[np.flatnonzero(is_read)]
    delta_p = ((mean - nearness * model.at_reference).reshape(1, n) @ spread).reshape(6)
    deviation = (deviation.reshape(1, n) @ spread).reshape(6)
    to_pivot = rigid_transform(np.eye(3), [0.0, 0.0, -model.pivot])
    displacement = inverse_transform(to_pivot) @ about_pivot(delta_p) @ to_pivot
    novelty = _difference(model, (mean / reach).clip(-FARTHEST, FARTHEST), X) / model.expected.limit
    return {
        "displacement": displacement,
        "correction": inverse(displacement),
        "delta_p": delta_p,
        "deviation": where(graph.constant(is_read), deviation, np.nan),
        "similarity": graph.constant(np.nan),
        "novelty": novelty,
        "is_recognised": novelty <= 1.0,
    }


def _predicted(regressor: Any, x: Value) -> tuple[Value, Value]:
    """What a regressor predicts of features (n_features,), and its standard deviation."""
    if isinstance(regressor, KernelRegressor):
        return _posterior(regressor, x)
    if isinstance(regressor, NetworkRegressor) and not isinstance(regressor, BayesianLMRegressor):
        return _network(regressor, x)
    raise ModelError(
        f"The regressor {type(regressor).__name__} has no ONNX form; train with "
        "gaussian_process or lm, or use servoscope serve."
    )


def _posterior(regressor: KernelRegressor, x: Value) -> tuple[Value, Value]:
    """As `KernelPosterior`."""
    posterior, graph, n = regressor.posterior_, x.graph, len(regressor.posterior_.y)
    kernel = posterior.kernel
    here, there = (x - kernel.centre) / kernel.length_scales, kernel.scaled(posterior.X)
    apart = graph.constant(there) - here.reshape(1, there.shape[1])
    k = graph.apply("Exp", -0.5 * (apart * apart).sum(1)) * kernel.signal**2
    mean = (k * posterior.weights).sum() + kernel.offset
    explained = ((k.reshape(1, n) @ graph.constant(posterior.inverse)).reshape(n) * k).sum()
    variance = maximum(kernel.signal**2 - explained, 0.0) + kernel.noise**2
    return mean, variance.sqrt()


def _network(regressor: NetworkRegressor, x: Value) -> tuple[Value, Value]:
    """As `TrainedNetwork`; the hyperbolic tangent by the exponential, which all versions have."""
    network, n = regressor.network_, len(regressor.network_.inputs.mean)
    hidden, out = split_weights(network.weights, n + 1)
    inputs = ((x - network.inputs.mean) * network.inputs.scale).reshape(n, 1)
    total = (hidden[:, :-1] @ inputs).reshape(len(hidden)) + hidden[:, -1]
    units = 1.0 - 2.0 / (x.graph.apply("Exp", 2.0 * total.clip(-30.0, 30.0)) + 1.0)
    output = (units * out[:-1]).sum() + float(out[-1])
    mean = output / float(network.target.scale) + float(network.target.mean)
    return mean, x.graph.constant(np.float64(network.error))


def _difference(model: FeatureModel, shares: Value, X: Value) -> Value:
    """As `ExpectedFeatures.differences`."""
    expected, n = model.expected, len(model.dofs)
    i, j = np.triu_indices(n)
    products = shares.take(i.astype(np.int64)) * shares.take(j.astype(np.int64))
    terms = concatenate([np.ones(1), shares, products])
    n_terms, n_features = expected.coefficients.shape
    made = (terms.reshape(1, n_terms) @ X.graph.constant(expected.coefficients)).reshape(n_features)
    rest = (X - made) / expected.deviation
    return ((rest * rest).sum() / float(n_features)).sqrt()
