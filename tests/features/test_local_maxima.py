import numpy as np
import pytest
from scipy.ndimage import correlate

from servoscope.errors import InvalidInputError
from servoscope.features.local_maxima import (
    brightest_separate,
    centre_weighted_mask,
    filter_centre_weighted,
)


def test_mask_is_the_inverse_distance_to_its_centre():
    mask = centre_weighted_mask(12)
    assert mask.sum() == pytest.approx(1)
    assert mask[5, 5] / mask[0, 0] == pytest.approx(11)
    assert mask[6, 6] / mask[6, 11] == pytest.approx(np.hypot(5.5, 0.5) / np.hypot(0.5, 0.5))


@pytest.mark.parametrize("window", [4, 12])
@pytest.mark.parametrize("shape", [(30, 41), (1, 5), (40, 3)])
def test_filter_is_that_of_scipy(window, shape):
    image = np.random.default_rng(0).uniform(size=shape)
    expected = correlate(image, centre_weighted_mask(window), mode="constant")
    np.testing.assert_allclose(filter_centre_weighted(image, window), expected, atol=1e-12)


def test_bright_pixel_lights_the_subwindows_that_cover_it():
    image = np.zeros((20, 20))
    image[10, 10] = 1
    rows, columns = np.nonzero(filter_centre_weighted(image, 4) > 1e-12)
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (9, 12, 9, 12)


@pytest.mark.parametrize("window", [0, 5, 2.0, None])
def test_windows_without_a_centre_between_pixels_are_refused(window):
    with pytest.raises(InvalidInputError, match="even number of pixels from 2"):
        centre_weighted_mask(window)


def test_subwindows_do_not_overlap_and_get_no_brighter():
    image = np.random.default_rng(1).uniform(size=(60, 60))
    found = brightest_separate(image, 8, 12)
    distances = np.abs(found[:, None] - found).max(axis=2) + 99 * np.eye(8, dtype=int)
    assert distances.min() >= 12
    assert (np.diff(image[tuple(found.T)]) <= 0).all()
    assert image[tuple(found[0])] == image.max()


def test_too_many_subwindows_are_refused_with_both_numbers():
    with pytest.raises(InvalidInputError, match=r"12 separate subwindows .* only 4 were found"):
        brightest_separate(np.eye(24)[::-1] * 0, 12, 12)
