"""The photometric interaction matrix, learned: what it is, and what it is not."""

import json

import numpy as np
import pytest

from planar import RANGES, planar_images
from servoscope.features import PoseImageCovariance
from servoscope.positioning.appearance import Appearance
from servoscope.positioning.interaction import MARGIN, LearnedInteraction, learn_interaction
from servoscope.positioning.polynomials import evaluate_terms, exponents

SIZE = 24
SHARP = Appearance(blur=1 / 256)
"""Smooths images of that size by a tenth of a pixel, and does not shrink them."""


def polynomial_images(p: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Images that are quadratic in the displacement, and their coefficients."""
    coefficients = rng.normal(size=(len(exponents(2)), SIZE * SIZE)) * 10
    images = evaluate_terms(exponents(2), p) @ coefficients
    return images.reshape(-1, SIZE, SIZE).astype(np.float32), coefficients


def learn_planar(n_images: int, radius: float, seed: int = 0, error: float = 0.0):
    """A level learned from a textured plane, with the images and the true displacements.

    `error` is the standard deviation of the displacements that are told, in radii.
    """
    rng = np.random.default_rng(seed)
    p = radius * rng.uniform(-1, 1, (n_images, 6))
    images = planar_images(p * RANGES, SIZE, seed=3)
    told = p + error * radius * rng.normal(size=p.shape)
    return learn_interaction(images, told, radius, 2, SHARP), images, p


def rows_agree(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Correlation of each row with its counterpart."""
    a, b = (x - x.mean(axis=1, keepdims=True) for x in (a, b))
    return (a * b).sum(axis=1) / np.linalg.norm(a, axis=1) / np.linalg.norm(b, axis=1)


@pytest.mark.parametrize("radius", [1.0, 0.25])
def test_of_images_that_are_a_polynomial_the_true_one_is_learned(rng, radius) -> None:
    p = rng.uniform(-1, 1, (300, 6))
    images, coefficients = polynomial_images(p, rng)
    level = learn_interaction(images, radius * p, radius, 2, SHARP)
    np.testing.assert_allclose(level.model.coefficients, coefficients, atol=0.03)


def test_images_beyond_the_margin_are_not_learned_from(rng) -> None:
    p = rng.uniform(-1, 1, (300, 6))
    images, _ = polynomial_images(p, rng)
    level = learn_interaction(images, 0.5 * p, 0.5, 2, SHARP)
    beyond = np.full((20, 6), 1.01 * MARGIN * 0.5)
    garbage = rng.integers(0, 256, (20, SIZE, SIZE)).astype(np.float32)
    with_garbage = learn_interaction(
        np.concatenate([images, garbage]), np.vstack([0.5 * p, beyond]), 0.5, 2, SHARP
    )
    np.testing.assert_array_equal(with_garbage.model.coefficients, level.model.coefficients)


def test_pixels_that_the_polynomial_does_not_explain_weigh_less(rng) -> None:
    p = rng.uniform(-1, 1, (200, 6))
    images, _ = polynomial_images(p, rng)
    images[:, :, SIZE // 2 :] += rng.normal(0, 30, images[:, :, SIZE // 2 :].shape)
    precision = learn_interaction(images, p, 1.0, 2, SHARP).model.precision.reshape(SIZE, SIZE)
    assert precision[:, : SIZE // 2 - 3].min() > 1.15 * precision[:, SIZE // 2 + 3 :].max()


def test_it_is_the_covariance_with_the_poses_but_for_a_factor_of_each_dof() -> None:
    level, images, p = learn_planar(2500, 0.05)
    interaction = level.model.coefficients[1:7]
    covariance = PoseImageCovariance().fit(images, p).components_
    assert rows_agree(interaction, covariance).min() > 0.95
    # Pose-image covariance divides every image by its length; without that they agree still more.
    centred = (images - images.mean(axis=0)).reshape(len(images), -1)
    assert rows_agree(interaction, p.T @ centred).min() > 0.97
    normalised = np.linalg.solve(p.T @ p, p.T @ centred) * level.radius
    assert rows_agree(interaction, normalised).min() > 0.999
    factors = np.linalg.norm(normalised, axis=1) / np.linalg.norm(interaction, axis=1)
    np.testing.assert_allclose(factors, 1, atol=0.02)


def test_of_dofs_that_move_together_the_covariance_tells_no_longer_which_one_it_was() -> None:
    rng = np.random.default_rng(0)
    p = 0.05 * rng.uniform(-1, 1, (2500, 6))
    p[:, 1] = 0.8 * p[:, 0] + 0.6 * p[:, 1]
    images = planar_images(p * RANGES, SIZE, seed=3)
    true = learn_planar(2500, 0.05)[0].model.coefficients[1:7]
    learned = learn_interaction(images, p, 0.05, 2, SHARP).model.coefficients[1:7]
    covariance = PoseImageCovariance().fit(images, p).components_
    assert rows_agree(true, learned)[:2].min() > 0.99
    assert rows_agree(true, covariance)[:2].max() < 0.9


def test_errors_of_the_robot_only_shrink_it_as_those_of_any_regressor_do() -> None:
    error = 0.25
    true, noisy = (learn_planar(4000, 0.05, error=e)[0] for e in (0.0, error))
    a, b = (level.model.coefficients[1:7] for level in (true, noisy))
    slopes = (a * b).sum(axis=1) / (a * a).sum(axis=1)
    np.testing.assert_allclose(slopes, 1 / (1 + 3 * error**2), rtol=0.06)
    assert rows_agree(a, b).min() > 0.98


def test_errors_of_the_robot_do_not_displace_the_reference() -> None:
    reference = planar_images(np.zeros((1, 6)), SIZE, seed=3)[0]
    p = np.array(
        [
            level.at_reference(reference).align(reference, np.zeros(6)).p
            for level in (learn_planar(400, 0.05, seed, error=0.25)[0] for seed in range(4))
        ]
    )
    assert np.abs(p).max() < 1e-3


def test_a_planar_image_is_found_from_a_first_guess_that_is_off(rng) -> None:
    level, _, _ = learn_planar(400, 0.2)
    p = 0.2 * rng.uniform(-0.7, 0.7, (10, 6))
    images = planar_images(p * RANGES, SIZE, seed=3)
    found = [level.align(image, np.zeros(6)) for image in images]
    errors = np.array([level.displacement(a) for a in found]) - p
    assert np.abs(errors).max() < 0.1 * 0.2
    assert all(level.std(a).shape == (6,) and (level.std(a) > 0).all() for a in found)


def test_it_is_restored_as_it_was() -> None:
    level, images, _ = learn_planar(200, 0.2)
    description = json.loads(json.dumps({**level.describe(), "unlikeness_limit": 0.5}))
    again = LearnedInteraction.restore(description, level.to_arrays())
    assert again.describe() == description
    np.testing.assert_array_equal(
        again.align(images[0], np.zeros(6)).p, level.align(images[0], np.zeros(6)).p
    )


def test_only_the_share_of_the_radius_matters() -> None:
    level, images, p = learn_planar(300, 0.1)
    shrunk = learn_interaction(images, p / 0.1, 1.0, 2, SHARP)
    np.testing.assert_allclose(shrunk.model.coefficients, level.model.coefficients, atol=1e-3)
