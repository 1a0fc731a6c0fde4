import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from servoscope.keyframe.fitting import MOST_IMAGES, chosen_images
from servoscope.keyframe.levels import correlation, spread_rotations
from servoscope.keyframe.limit import cramer_rao, pixel_noise
from servoscope.keyframe.motion import exponential
from servoscope.keyframe.relief import semi_global_labels


def test_labels_of_clear_costs_are_their_minima_to_a_fraction():
    labels = np.arange(12)
    true = np.tile(np.linspace(2.3, 8.3, 20), (10, 1))
    costs = 0.5 * (labels - true[..., None]) ** 2
    even = np.zeros((10, 20), np.float32)
    found = semi_global_labels(costs.astype(np.float32), even, 10.0)
    np.testing.assert_allclose(found, true, atol=0.15)


def test_pixels_without_information_take_the_label_of_their_neighbours():
    costs = np.zeros((12, 12, 8), np.float32)
    costs[2:-2, 2:-2] = np.abs(np.arange(8) - 5)
    costs[5:7, 5:7] = 0
    found = semi_global_labels(costs, np.zeros((12, 12), np.float32), 10.0)
    np.testing.assert_allclose(found[5:7, 5:7], 5, atol=0.5)


def test_relief_jumps_at_an_edge_of_the_image():
    costs = np.zeros((16, 16, 10), np.float32)
    costs[:, 0] = 2 * np.abs(np.arange(10) - 2)
    costs[:, -1] = 2 * np.abs(np.arange(10) - 7)
    guide = np.zeros((16, 16), np.float32)
    guide[:, 6:] = 200
    found = semi_global_labels(costs, guide, 10.0)
    np.testing.assert_allclose(found[:, 1:5], 2, atol=0.6)
    np.testing.assert_allclose(found[:, 7:15], 7, atol=0.6)


def test_rotations_leave_no_gap_wider_than_30_degrees():
    found = Rotation.from_matrix(spread_rotations(500))
    assert len(found) == 524
    for probe in Rotation.random(50, rng=np.random.default_rng(0)):
        assert np.degrees((found.inv() * probe).magnitude().min()) < 30


def test_correlation_is_that_of_numpy_and_blind_to_gain_and_offset():
    rng = np.random.default_rng(0)
    image = rng.uniform(0, 255, (20, 20)).astype(np.float32)
    grid = (np.arange(1, 19) + 0.5) / 20 - 0.5
    rays = np.stack(np.meshgrid(grid, grid), -1).reshape(-1, 2).astype(np.float32)
    depth, camera = np.ones(len(rays), np.float32), np.array([1.0, 0, 0, 0, 0])
    other = rng.uniform(0, 255, len(rays)).astype(np.float32)
    found = correlation(image, np.eye(4), camera, 1.0, rays, depth, other)
    expected = np.corrcoef(image[1:-1, 1:-1].ravel(), other)[0, 1]
    assert found == pytest.approx(expected, abs=1e-3)
    brighter = (3 * image + 20).astype(np.float32)
    again = correlation(brighter, np.eye(4), camera, 1.0, rays, depth, other)
    assert again == pytest.approx(found, abs=1e-3)


@pytest.mark.parametrize("sigma", [1.0, 4.0])
def test_noise_of_pixels_is_found_beside_texture(sigma):
    rng = np.random.default_rng(1)
    ramp = np.add.outer(np.linspace(50, 150, 128), np.linspace(0, 60, 128))
    ramp[:, 64:] += 30 * np.sin(np.arange(64))
    images = (ramp + sigma * rng.normal(size=(5, 128, 128))).round().clip(0, 255).astype(np.uint8)
    assert pixel_noise(images) == pytest.approx(sigma, rel=0.2)


def test_bound_is_the_covariance_of_least_squares():
    rng = np.random.default_rng(2)
    J = rng.normal(size=(600, 8))
    estimates = np.linalg.lstsq(J, 3.0 * rng.normal(size=(600, 4000)), rcond=None)[0][:6]
    limit = cramer_rao(J, 3.0, (20, 30))
    np.testing.assert_allclose(limit.std, estimates.std(axis=1), rtol=0.06)
    np.testing.assert_allclose(limit.shares.sum(axis=(1, 2)), 1, rtol=1e-4)
    assert "tx" in str(limit)


def test_of_many_images_far_ones_are_taken_though_most_are_near():
    rng = np.random.default_rng(3)
    radius = np.concatenate([np.full(900, 0.01), np.full(60, 0.2), np.full(40, 0.4)])
    twists = np.zeros((1000, 6))
    twists[:, 3:] = radius[:, None] * rng.dirichlet(np.ones(3), 1000) ** 0.5  # of length radius
    chosen = chosen_images(exponential(twists), 0.5)
    assert len(chosen) == len(set(chosen)) == MOST_IMAGES
    assert np.count_nonzero(radius[chosen] > 0.1) > 0.6 * MOST_IMAGES
    assert (np.diff(radius[chosen]) > -0.01).all()
    few = chosen_images(exponential(twists[::50]), 0.5)
    assert sorted(few) == list(range(20))
