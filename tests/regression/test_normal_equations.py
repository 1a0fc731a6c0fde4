import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from servoscope.regression.levenberg_marquardt import (
    DualEquations,
    PrimalEquations,
    normal_equations,
)
from servoscope.regression.tanh_network import (
    activate,
    append_ones,
    initial_weights,
    linearise,
)


def _random_problem(n, k, hidden, seed=0):
    rng = np.random.default_rng(seed)
    inputs = append_ones(rng.normal(size=(n, k)))
    weights = initial_weights(k, hidden, rng)
    return (
        inputs,
        weights,
        linearise(weights, inputs, activate(weights, inputs)),
        rng.normal(size=n),
    )


def _both(inputs, hidden, dtype):
    return DualEquations(inputs, dtype), PrimalEquations(inputs, hidden, dtype)


@given(
    n=st.integers(1, 30),
    k=st.integers(1, 6),
    hidden=st.integers(1, 6),
    damping=st.floats(1e-2, 1e3),
    weight_decay=st.sampled_from([0.0, 0.1, 10.0]),
    seed=st.integers(0, 100),
)
def test_both_forms_solve_the_damped_normal_equations(n, k, hidden, damping, weight_decay, seed):
    inputs, weights, derivatives, residuals = _random_problem(n, k, hidden, seed)
    J = derivatives.jacobian()
    descent = J.T @ residuals - weight_decay * weights
    damped = J.T @ J + (damping + weight_decay) * np.eye(weights.size)
    expected = np.linalg.solve(damped, descent)
    scale = np.abs(expected).max()
    for equations in _both(inputs, hidden, np.float64):
        equations.linearise(derivatives)
        step = equations.step(residuals, weights, damping, weight_decay)
        np.testing.assert_allclose(step.change, expected, rtol=0, atol=1e-9 * scale)
        assert step.slope == pytest.approx(expected @ descent, rel=1e-8, abs=1e-12)


@pytest.mark.parametrize("form", [0, 1], ids=["dual", "primal"])
def test_single_precision_gives_the_step_to_four_digits(form):
    inputs, weights, derivatives, residuals = _random_problem(120, 8, 12)
    steps = []
    for dtype in (np.float32, np.float64):
        equations = _both(inputs, 12, dtype)[form]
        equations.linearise(derivatives)
        steps.append(equations.step(residuals, weights, 1.0, 0.1))
    error = np.linalg.norm(steps[0].change - steps[1].change)
    assert error < 1e-4 * np.linalg.norm(steps[1].change)
    assert steps[0].slope == pytest.approx(steps[1].slope, rel=1e-4)


@pytest.mark.parametrize("form", [0, 1], ids=["dual", "primal"])
def test_a_rejected_damping_leaves_the_system_as_it_was(form):
    inputs, weights, derivatives, residuals = _random_problem(40, 3, 5)
    equations = _both(inputs, 5, np.float64)[form]
    equations.linearise(derivatives)
    first = equations.step(residuals, weights, 0.1, 0.0).change
    equations.step(residuals, weights, 100.0, 0.0)
    np.testing.assert_array_equal(equations.step(residuals, weights, 0.1, 0.0).change, first)


def test_a_matrix_that_is_not_positive_definite_gives_no_step():
    inputs, weights, derivatives, residuals = _random_problem(60, 1, 3)
    dual = DualEquations(inputs, np.float64)
    dual.linearise(derivatives)
    assert dual.step(residuals, weights, -1.0, 0.0) is None


@pytest.mark.parametrize(("k", "form"), [(65, DualEquations), (2, PrimalEquations)])
def test_many_weights_are_solved_over_samples_and_few_over_weights(k, form):
    inputs, weights, derivatives, residuals = _random_problem(200, k, 10)
    chosen = normal_equations(inputs, 10)
    expected = DualEquations(inputs) if form is DualEquations else PrimalEquations(inputs, 10)
    for equations in (chosen, expected):
        equations.linearise(derivatives)
    np.testing.assert_array_equal(
        chosen.step(residuals, weights, 1.0, 0.0).change,
        expected.step(residuals, weights, 1.0, 0.0).change,
    )


@pytest.mark.parametrize("k", [2, 65], ids=["primal", "dual"])
@pytest.mark.parametrize("damping", [1e-1, 1e-3, 1e-5, 1e-7])
def test_small_dampings_lose_no_digits_to_rounding(k, damping):
    inputs, weights, derivatives, residuals = _random_problem(200, k, 10)
    chosen, exact = normal_equations(inputs, 10), PrimalEquations(inputs, 10, np.float64)
    for equations in (chosen, exact):
        equations.linearise(derivatives)
    found = chosen.step(residuals, weights, damping, 0.0).change
    expected = exact.step(residuals, weights, damping, 0.0).change
    np.testing.assert_allclose(found, expected, atol=0.05 * np.abs(expected).max())
