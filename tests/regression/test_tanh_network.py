import numpy as np
import pytest
from scipy.optimize import approx_fprime

from servoscope.regression.tanh_network import (
    activate,
    append_ones,
    count_weights,
    evaluate,
    initial_weights,
    linearise,
    split_weights,
)


@pytest.fixture(params=[(1, 1), (3, 4), (7, 2)], ids=str)
def network(request):
    k, hidden = request.param
    rng = np.random.default_rng(k)
    inputs = append_ones(rng.normal(size=(11, k)))
    return initial_weights(k, hidden, rng), inputs


def _central_differences(function, point, step=1e-6):
    columns = [
        (function(point + step * e) - function(point - step * e)) / (2 * step)
        for e in np.eye(point.size)
    ]
    return np.stack(columns, axis=-1)


def test_output_is_the_sum_over_units_written_out(network):
    weights, inputs = network
    W, v = split_weights(weights, inputs.shape[1])
    expected = [sum(v[j] * np.tanh(W[j] @ row) for j in range(len(W))) + v[-1] for row in inputs]
    np.testing.assert_allclose(evaluate(weights, inputs), expected, rtol=1e-13, atol=1e-14)


def test_number_of_weights(network):
    weights, inputs = network
    hidden = len(split_weights(weights, inputs.shape[1])[0])
    assert weights.size == count_weights(inputs.shape[1] - 1, hidden)


def test_jacobian_equals_central_differences(network):
    weights, inputs = network
    J = linearise(weights, inputs, activate(weights, inputs)).jacobian()
    expected = _central_differences(lambda w: evaluate(w, inputs), weights)
    np.testing.assert_allclose(J, expected, atol=3e-9)


def test_jacobian_equals_forward_differences_of_scipy(network):
    weights, inputs = network
    J = linearise(weights, inputs, activate(weights, inputs)).jacobian()
    expected = approx_fprime(weights, lambda w: evaluate(w, inputs))
    np.testing.assert_allclose(J, expected, atol=2e-6)


def test_products_equal_those_with_the_whole_jacobian(network):
    weights, inputs = network
    rng = np.random.default_rng(0)
    derivatives = linearise(weights, inputs, activate(weights, inputs))
    J = derivatives.jacobian()
    direction, residuals = rng.normal(size=weights.size), rng.normal(size=len(inputs))
    np.testing.assert_allclose(derivatives.times(direction), J @ direction, atol=1e-13)
    np.testing.assert_allclose(derivatives.transposed_times(residuals), J.T @ residuals, atol=1e-13)
