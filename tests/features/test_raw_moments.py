import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from servoscope.errors import InvalidInputError
from servoscope.features.raw_moments import ORDERS, compute_raw_moments, largest_raw_moment

SLICES = ((0, 50), (50, 100), (100, 150), (0, 256))


def opencv_moments(image, lower, upper):
    grey = np.arange(256)
    table = np.where((grey >= lower) & (grey < upper), grey, 0).astype(np.uint8)
    moments = cv2.moments(cv2.LUT(image, table))
    return [moments[f"m{i}{j}"] for i, j in ORDERS]


@settings(deadline=None, max_examples=40)
@given(st.integers(1, 70), st.integers(1, 300), st.integers(0, 2**32 - 1))
def test_raw_moments_equal_opencv_exactly(height, width, seed):
    images = np.random.default_rng(seed).integers(0, 256, (2, height, width), dtype=np.uint8)
    expected = [[opencv_moments(image, *bounds) for bounds in SLICES] for image in images]
    np.testing.assert_array_equal(compute_raw_moments(images, SLICES), expected)


@pytest.mark.parametrize("shape", [(2048, 2048), (1, 2048), (2048, 1), (3, 129)])
def test_raw_moments_of_white_images_are_exact_integers(shape):
    height, width = shape
    x_sums = [sum(x**i for x in range(width)) for i in range(4)]
    y_sums = [sum(y**j for y in range(height)) for j in range(4)]
    moments = compute_raw_moments(np.full((1, *shape), 255, np.uint8), [(0, 256)])
    assert moments[0, 0].tolist() == [255 * x_sums[i] * y_sums[j] for i, j in ORDERS]


def test_largest_raw_moment_is_that_of_a_white_image():
    white = np.full((1, 40, 300), 255, np.uint8)
    assert largest_raw_moment(40, 300) == compute_raw_moments(white, [(0, 256)]).max()


def test_images_whose_moments_might_overflow_are_refused():
    with pytest.raises(InvalidInputError, match=r"3000 x 3000 .* might not fit in 64 bits"):
        compute_raw_moments(np.zeros((1, 3000, 3000), np.uint8), SLICES)


def test_a_grey_level_on_a_bound_belongs_to_the_upper_slice_only():
    images = np.full((1, 2, 2), 50, np.uint8)
    assert compute_raw_moments(images, [(0, 50), (50, 100)])[0, :, 0].tolist() == [0, 200]


def test_views_are_summed_as_they_look():
    images = np.random.default_rng(0).integers(0, 256, (3, 20, 30), dtype=np.uint8)
    mirrored = images[:, :, ::-1]
    np.testing.assert_array_equal(
        compute_raw_moments(mirrored, SLICES), compute_raw_moments(mirrored.copy(), SLICES)
    )
