"""Where an image was taken is found in images that are polynomials of the displacement."""

import warnings

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from servoscope.positioning.alignment import ImageModel, align
from servoscope.positioning.polynomials import exponents

NOISE = 2.0


def smooth_fields(n: int, shape: tuple[int, int], seed: int = 0) -> np.ndarray:
    """Random smooth images of standard deviation 1, (n, n_pixels)."""
    noise = np.random.default_rng(seed).normal(size=(n, *shape))
    fields = np.array([cv2.GaussianBlur(field, (0, 0), 2.0).ravel() for field in noise])
    return fields / fields.std(axis=1, keepdims=True)


def image_model(shape: tuple[int, int] = (32, 32)) -> ImageModel:
    """A texture that six displacements change in ways of their own, a little nonlinearly."""
    powers = exponents(2)
    amplitudes = np.select([powers.sum(axis=1) == 0, powers.sum(axis=1) == 1], [40.0, 25.0], 3.0)
    coefficients = amplitudes[:, None] * smooth_fields(len(powers), shape)
    coefficients[0] += 120
    precision = np.full(coefficients.shape[1], 1 / NOISE, np.float32)
    return ImageModel(powers, coefficients.astype(np.float32), precision, shape)


MODEL = image_model()
START = np.array([0.3, -0.2, 0.1, 0.2, -0.3, 0.25])

displacements = arrays(float, 6, elements=st.floats(-0.7, 0.7))


def image_at(p: np.ndarray, model: ImageModel = MODEL) -> np.ndarray:
    return model.linearise(p)[0].reshape(model.shape)


def test_the_interaction_matrix_is_the_derivative_of_the_image() -> None:
    h = 1e-2
    _, interaction = MODEL.linearise(START)
    for dof in range(6):
        ahead, behind = (image_at(START + sign * h * np.eye(6)[dof]) for sign in (1, -1))
        expected = (ahead - behind).ravel() / (2 * h)
        np.testing.assert_allclose(interaction[dof], expected, atol=0.02)


@settings(max_examples=60)
@given(displacements)
def test_the_displacement_is_found_exactly(p) -> None:
    found = align(MODEL, image_at(p), np.zeros(6))
    np.testing.assert_allclose(found.p, p, atol=1e-4)
    assert found.unlikeness < 1e-3


@settings(max_examples=60)
@given(displacements, st.floats(0.5, 1.6), st.floats(-40, 40), st.floats(-0.3, 0.3))
def test_gain_offset_and_a_little_defocus_make_no_difference(p, gain, offset, defocus) -> None:
    image = image_at(p)
    laplacian = cv2.Laplacian(image, cv2.CV_32F, borderType=cv2.BORDER_REPLICATE)
    seen = np.float32(gain) * image + np.float32(offset) + np.float32(defocus) * laplacian
    np.testing.assert_allclose(align(MODEL, seen, np.zeros(6)).p, p, atol=1e-3)


@pytest.mark.parametrize("grey", [0.0, 120.0, 255.0])
@pytest.mark.parametrize("corner", [(0, 0), (10, 8), (20, 18)])
def test_15_percent_of_covered_pixels_hardly_matter(grey, corner) -> None:
    image = image_at(START).copy()
    top, left = corner
    image[top : top + 12, left : left + 13] = grey
    found = align(MODEL, image, np.zeros(6))
    np.testing.assert_allclose(found.p, START, atol=0.02)
    assert found.unlikeness < 0.05


@pytest.mark.parametrize("shape", [(32, 32), (24, 24), (7, 48), (48, 10)])
def test_the_covariance_predicts_the_scatter_under_noise(rng, shape) -> None:
    model = image_model(shape)
    image = image_at(START, model)
    found = [
        align(model, (image + rng.normal(0, NOISE, shape)).astype(np.float32), START)
        for _ in range(150)
    ]
    scatter = np.cov(np.array([alignment.p for alignment in found]).T)
    predicted = np.mean([alignment.covariance for alignment in found], axis=0)
    ratio = np.sqrt(np.diag(predicted) / np.diag(scatter))
    np.testing.assert_allclose(ratio, 1, atol=0.3)
    np.testing.assert_allclose(
        np.mean([alignment.p for alignment in found], axis=0), START, atol=0.005
    )


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((32, 32)),
        np.full((32, 32), 255.0),
        np.indices((32, 32)).sum(axis=0) % 2 * 255.0,
        np.eye(32) * 255.0,
    ],
    ids=["black", "white", "checks", "diagonal"],
)
def test_images_that_tell_nothing_give_finite_numbers(image) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = align(MODEL, image.astype(np.float32), np.zeros(6))
    assert np.isfinite(found.p).all()
    assert np.isfinite(found.covariance).all()
    assert (np.abs(found.p) <= 1.5).all()
    assert found.unlikeness > 0.5
    assert np.isfinite(found.unlikeness)


def test_a_model_without_texture_gives_finite_numbers() -> None:
    flat = np.zeros_like(MODEL.coefficients)
    model = ImageModel(MODEL.powers, flat, MODEL.precision, MODEL.shape)
    for image in (image_at(START), np.zeros(MODEL.shape, np.float32)):
        found = align(model, image, np.zeros(6))
        assert np.isfinite([*found.p, *found.covariance.ravel(), found.unlikeness]).all()


def test_an_image_of_something_else_is_unlike() -> None:
    other = 120 + 40 * smooth_fields(1, MODEL.shape, seed=9).reshape(MODEL.shape)
    assert align(MODEL, other.astype(np.float32), np.zeros(6)).unlikeness > 0.3


def test_a_start_beyond_the_radius_begins_at_its_border() -> None:
    np.testing.assert_allclose(align(MODEL, image_at(START), 40 * START).p, START, atol=0.01)
