import numpy as np
import pytest

from servoscope.errors import InvalidInputError
from servoscope.features import pixels
from servoscope.features.pixels import (
    brightness_norms,
    check_finite,
    flatten_images,
    normalised_blocks,
    project_images,
)


def grey_images(n=7, height=20, width=33, seed=0):
    return np.random.default_rng(seed).integers(0, 256, (n, height, width), dtype=np.uint8)


def whole(blocks):
    return np.concatenate([block for _, _, block in blocks], axis=1)


def test_flat_images_take_the_shape_they_are_said_to_have():
    flat, shape = flatten_images(np.zeros((2, 12)), (3, 4))
    assert (flat.shape, shape) == ((2, 12), (3, 4))


def test_flat_images_of_unknown_shape_are_one_row_high():
    assert flatten_images(np.zeros((2, 12)), None)[1] == (1, 12)


def test_flattening_makes_no_copy():
    images = grey_images()
    assert np.shares_memory(flatten_images(images, None)[0], images)


@pytest.mark.parametrize(
    ("images", "image_shape", "message"),
    [
        (np.zeros((2, 13)), (3, 4), "3 x 4 .* have 12 pixels, got 13"),
        (np.zeros((2, 4, 3)), (3, 4), "must be 3 x 4 .* got 4 x 3"),
        (np.zeros(12), None, r"got \(12,\)"),
        (np.zeros((1, 3, 4, 3)), None, r"got \(1, 3, 4, 3\)"),
        (np.zeros((2, 12)), (3, -4), "two whole numbers from 1"),
        (np.zeros((2, 12)), 12, "two whole numbers from 1"),
        ([np.zeros((2, 3)), np.zeros((3, 3))], None, "images of different sizes"),
    ],
)
def test_images_of_the_wrong_shape_are_refused(images, image_shape, message):
    with pytest.raises(InvalidInputError, match=message) as error:
        flatten_images(images, image_shape)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_pixels_that_are_not_finite_are_counted_by_image(bad):
    flat = np.ones((5, 4))
    flat[[1, 3], 2] = bad
    with pytest.raises(InvalidInputError, match=r"image 1 holds NaN or infinity \(2 such"):
        check_finite(flat)


def test_brightness_norms_of_grey_images_are_exact():
    white = np.full((1, 300 * 300), 255, np.uint8)
    assert brightness_norms(white)[0] == 255 * 300


def test_normalised_images_have_unit_length_and_black_ones_stay_black():
    flat = grey_images().reshape(7, -1)
    flat[3] = 0
    lengths = np.linalg.norm(whole(normalised_blocks(flat, np.zeros(flat.shape[1]))), axis=1)
    np.testing.assert_allclose(lengths, [1, 1, 1, 0, 1, 1, 1], rtol=1e-6)


def test_blocks_are_centred_on_their_own_mean_by_default():
    flat = grey_images().reshape(7, -1).astype(float)
    normalised = flat / np.linalg.norm(flat, axis=1, keepdims=True)
    np.testing.assert_allclose(
        whole(normalised_blocks(flat)), normalised - normalised.mean(axis=0), atol=1e-16
    )


def test_width_of_the_blocks_does_not_matter(monkeypatch):
    flat = grey_images(height=40, width=70).reshape(7, -1)
    mean, components = np.full(2800, 0.01), np.random.default_rng(1).normal(size=(3, 2800))
    in_one = project_images(flat, mean, components)
    monkeypatch.setattr(pixels, "BLOCK_PIXELS", 97)
    assert len(list(normalised_blocks(flat))) == 29
    np.testing.assert_allclose(project_images(flat, mean, components), in_one, atol=2e-6)


def test_blocks_of_many_images_are_narrow():
    flat = np.broadcast_to(np.uint8(1), (100_000, 4096))
    _, _, block = next(normalised_blocks(flat, np.zeros(4096)))
    assert block.nbytes < 50e6


def test_pixels_too_large_to_be_squared_are_refused():
    with pytest.raises(InvalidInputError, match="image 1 are not; scale the images down"):
        next(normalised_blocks(np.array([[1.0, 2.0], [1e200, 1.0]])))
