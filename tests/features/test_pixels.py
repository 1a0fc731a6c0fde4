import numpy as np
import pytest

from servoscope.errors import InvalidInputError
from servoscope.features.pixels import check_finite, flatten_images


def test_flat_images_take_the_shape_they_are_said_to_have():
    flat, shape = flatten_images(np.zeros((2, 12)), (3, 4))
    assert (flat.shape, shape) == ((2, 12), (3, 4))


def test_flat_images_of_unknown_shape_are_one_row_high():
    assert flatten_images(np.zeros((2, 12)), None)[1] == (1, 12)


def test_flattening_makes_no_copy():
    images = np.zeros((7, 20, 33), np.uint8)
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
