import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from servoscope.errors import InvalidInputError
from servoscope.features import normalised_images
from servoscope.features.normalised_images import (
    brightness_norms,
    map_blocks,
    project_images,
)
from servoscope.processes import one_blas_thread


def grey_images(n=7, height=20, width=33, seed=0):
    return np.random.default_rng(seed).integers(0, 256, (n, height, width), dtype=np.uint8)


def whole(flat, mean=None):
    blocks = map_blocks(lambda block, _: block, flat, mean)
    return np.concatenate([block for _, _, block in blocks], axis=1)


def test_brightness_norms_of_grey_images_are_exact():
    white = np.full((1, 300 * 300), 255, np.uint8)
    assert brightness_norms(white)[0] == 255 * 300


def test_normalised_images_have_unit_length_and_black_ones_stay_black():
    flat = grey_images().reshape(7, -1)
    flat[3] = 0
    lengths = np.linalg.norm(whole(flat, np.zeros(flat.shape[1])), axis=1)
    np.testing.assert_allclose(lengths, [1, 1, 1, 0, 1, 1, 1], rtol=1e-6)


def test_blocks_are_centred_on_their_own_mean_by_default():
    flat = grey_images().reshape(7, -1).astype(float)
    normalised = flat / np.linalg.norm(flat, axis=1, keepdims=True)
    np.testing.assert_allclose(whole(flat), normalised - normalised.mean(axis=0), atol=1e-16)


def test_width_of_the_blocks_does_not_matter(monkeypatch):
    flat = grey_images(height=40, width=70).reshape(7, -1)
    mean, components = np.full(2800, 0.01), np.random.default_rng(1).normal(size=(3, 2800))
    in_one = project_images(flat, mean, components)
    monkeypatch.setattr(normalised_images, "BLOCK_ELEMENTS", 7 * 97)
    assert len(list(map_blocks(lambda block, _: block, flat))) == 29
    np.testing.assert_allclose(project_images(flat, mean, components), in_one, atol=2e-6)


def test_blocks_of_many_images_are_narrow():
    flat = np.broadcast_to(np.uint8(1), (100_000, 4096))
    _, _, n_bytes = next(map_blocks(lambda block, _: block.nbytes, flat, np.zeros(4096)))
    assert n_bytes < 50e6


def test_pixels_too_large_to_be_squared_are_refused():
    with pytest.raises(InvalidInputError, match="image 1 are not; scale the images down"):
        whole(np.array([[1.0, 2.0], [1e200, 1.0]]))


def test_number_of_threads_does_not_change_a_bit(monkeypatch):
    monkeypatch.setattr(normalised_images, "BLOCK_ELEMENTS", 40 * 500)
    flat = grey_images(40, 100, 130).reshape(40, -1)
    mean, components = np.full(13000, 0.01), np.random.default_rng(1).normal(size=(30, 13000))
    results = []
    for n_threads in (1, 2, 3):
        with threadpool_limits(n_threads):
            results.append(project_images(flat, mean, components))
    np.testing.assert_array_equal(results[1], results[0])
    np.testing.assert_array_equal(results[2], results[0])


def test_threads_of_blas_are_given_back():
    with threadpool_limits(2), one_blas_thread() as before:
        with one_blas_thread() as inside:
            pass
        assert (before, inside) == (2, 1)
    with threadpool_limits(2):
        whole(grey_images().reshape(7, -1))
        with one_blas_thread() as after:
            assert after == 2
