import numpy as np
import pytest

from servoscope.keyframe.lighting import N_POSE, Light, LightGrid

RNG = np.random.default_rng(0)
ASPECT, K, N = 0.75, 4, 300
POINTS = RNG.uniform(-0.5, 0.5, (N, 2)) * [1, ASPECT]
GRID = LightGrid(POINTS, ASPECT, K)
ORDERED = POINTS[GRID.order]


def test_a_light_that_rises_in_straight_lines_is_exact_between_its_nodes():
    y, x = np.mgrid[0:K, 0:K] / (K - 1) - 0.5
    light = Light(np.stack([1 + 0.3 * x - 0.2 * y, 5 * x + 7 * y]))
    gain, offset = GRID.at_points(light)
    x, y = ORDERED[:, 0], ORDERED[:, 1] / ASPECT
    np.testing.assert_allclose(gain, 1 + 0.3 * x - 0.2 * y, atol=1e-6)
    np.testing.assert_allclose(offset, 5 * x + 7 * y, atol=1e-5)


def test_a_light_at_more_nodes_is_the_same_where_nodes_coincide():
    light = Light(RNG.normal(size=(2, 3, 3)), 0.3)
    fine = light.resized(5)
    np.testing.assert_allclose(fine.nodes[:, ::2, ::2], light.nodes, atol=1e-12)
    np.testing.assert_allclose(fine.resized(3).nodes, light.nodes, atol=1e-12)
    assert fine.defocus == 0.3


def dense_design():
    """Derivatives of residuals by twist, defocus, gains and offsets, and what they are made of."""
    jacobian = RNG.normal(size=(N, 6)).astype(np.float32)
    laplacian, grey = RNG.normal(size=(2, N)).astype(np.float32)
    hats = np.zeros((N, K * K))
    for j in range(K * K):
        nodes = np.zeros((2, K * K))
        nodes[0, j] = 1
        hats[:, j] = GRID.at_points(Light(nodes.reshape(2, K, K)))[0]
    design = np.hstack([jacobian, -laplacian[:, None], -hats * grey[:, None], -hats])
    return jacobian, laplacian, grey, design


def test_normal_equations_are_those_of_the_dense_design():
    jacobian, laplacian, grey, design = dense_design()
    residuals = RNG.normal(size=N).astype(np.float32)
    weights = RNG.uniform(0, 2, N).astype(np.float32)
    light = Light(RNG.normal(size=(2, K, K)), 0.2)
    H, g = GRID.normal_equations(jacobian, residuals, weights, laplacian, grey, light)
    none, _ = GRID.normal_equations(jacobian, residuals, 0 * weights, laplacian, grey, light)
    np.testing.assert_allclose(H - none, design.T @ (weights[:, None] * design), atol=1e-3)
    off = np.concatenate([[light.defocus], (light.nodes - Light.even(K).nodes).ravel()])
    expected = -design.T @ (weights * residuals)
    expected[N_POSE - 1 :] -= none[N_POSE - 1 :, N_POSE - 1 :] @ off
    np.testing.assert_allclose(g, expected, atol=1e-3)


def test_derivatives_without_light_are_those_of_the_best_light_for_each_step():
    jacobian, laplacian, grey, design = dense_design()
    weights = np.ones(N, np.float32)
    H, _ = GRID.normal_equations(jacobian, 0 * grey, weights, laplacian, grey, Light.even(K))
    found = GRID.without_light(jacobian, laplacian, grey, H)
    prior = H[6:, 6:] - design[:, 6:].T @ design[:, 6:]
    best = np.linalg.solve(design[:, 6:].T @ design[:, 6:] + prior, design[:, 6:].T @ jacobian)
    np.testing.assert_allclose(found, jacobian - design[:, 6:] @ best, atol=2e-3)


@pytest.mark.parametrize("k", [2, 8])
def test_light_costs_nothing_where_it_is_even_and_little_where_it_is_alike_everywhere(k):
    grid = LightGrid(POINTS, ASPECT, k)
    flat, bent = np.full(k * k, 0.3), np.full(k * k, 0.3)
    bent[0] = -0.3
    P = grid.prior[7 : 7 + k * k, 7 : 7 + k * k]
    assert flat @ P @ flat < 0.02
    assert bent @ P @ bent > 5
