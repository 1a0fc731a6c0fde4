"""What is said of images that were held out: errors, and how well each pixel is explained."""

import cv2
import numpy as np
import pytest

from layered_world import HEIGHT, WIDTH, photographs, poses_about, reported
from servoscope.keyframe import read_held_out

N, NOISE = 12, 3.0
REFERENCE = photographs(np.eye(4)[None], 99, noise=NOISE)[0]


@pytest.fixture(scope="module")
def moving():
    """Images with a spot on the right that shows something else in each."""
    displacements = poses_about(N, 0)
    images = photographs(displacements, 1, noise=NOISE)
    rng = np.random.default_rng(3)
    for image in images:
        spot = cv2.GaussianBlur(rng.uniform(0, 255, (40, 40)), (0, 0), 4)
        grey = cv2.normalize(spot, None, 20, 235, cv2.NORM_MINMAX)
        image[36:76, 120:160] = np.clip(grey + NOISE * rng.normal(size=grey.shape), 0, 255)
    return images, reported(displacements), REFERENCE, np.eye(4), np.arange(N) % 2


@pytest.fixture(scope="module")
def looks(moving):
    return read_held_out(*moving, n_jobs=1, pivot=0.1)


@pytest.mark.slow
def test_residuals_are_largest_where_something_else_is_seen(looks):
    rows, columns = looks.residual_map.shape
    assert (rows, columns) == (round(128 * HEIGHT / WIDTH), 128)
    scale = columns / WIDTH
    inside = (slice(int(44 * scale), int(68 * scale)), slice(int(128 * scale), int(152 * scale)))
    left = looks.residual_map[:, : int(80 * scale)]
    assert np.nanmedian(looks.residual_map[inside]) > 5 * np.nanmedian(left)


@pytest.mark.slow
def test_residuals_of_what_is_explained_are_near_the_noise(looks):
    prepared = cv2.resize(
        np.random.default_rng(0).normal(0, NOISE, (HEIGHT, WIDTH)), (128, 81),
        interpolation=cv2.INTER_AREA,
    )  # fmt: skip
    expected = cv2.GaussianBlur(prepared, (0, 0), 1.0).std()
    assert looks.noise == pytest.approx(expected, rel=0.3)
    quiet = np.nanquantile(looks.residual_map, 0.1)
    assert 0.9 < quiet / looks.noise < 3
    assert looks.residual.shape == (N,)
    assert looks.residual_over_noise > quiet / looks.noise  # the spot is in every image


@pytest.mark.slow
def test_what_is_held_out_does_not_depend_on_the_number_of_processes(moving, looks):
    shared = read_held_out(*moving, n_jobs=2, pivot=0.1)
    for name, value in vars(looks).items():
        np.testing.assert_array_equal(getattr(shared, name), value, err_msg=name)
