"""An image is compared with the reference without any model."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from planar import RANGES, planar_images
from servoscope.positioning import arrival
from servoscope.positioning.reference_view import ReferenceView, _quantile, similarity

IMAGE = planar_images(np.zeros((1, 6)), 128, seed=0)[0]
VIEW = ReferenceView(IMAGE)


def _noisy(image: np.ndarray, sigma: float, seed: int = 0) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(0, sigma, image.shape)
    return np.clip(image + noise, 0, 255).round().astype(np.uint8)


@pytest.mark.parametrize("sigma", [0.0, 1.0, 3.0, 10.0])
def test_the_reference_with_noise_equals_the_reference(sigma: float) -> None:
    reference = ReferenceView(_noisy(IMAGE, sigma, seed=100))
    equal = [arrival.is_equal(reference.compare(_noisy(IMAGE, sigma, s))) for s in range(40)]
    assert np.mean(equal) >= 0.9


@pytest.mark.parametrize("sigma", [0.0, 3.0])
@pytest.mark.parametrize("dof", range(6))
def test_an_image_from_beside_the_reference_does_not(dof: int, sigma: float) -> None:
    away = np.zeros((1, 6))
    away[0, dof] = 0.1 * RANGES[dof]
    image = _noisy(planar_images(away, 128, seed=0)[0], sigma)
    assert not arrival.is_equal(VIEW.compare(image))


def test_the_displacement_of_the_cells_is_about_that_of_the_image() -> None:
    for pixels in (0.25, 0.5, 1.0):
        shifted = ((1 - pixels) * IMAGE + pixels * np.roll(IMAGE, 1, axis=1)).round()
        shift = VIEW.compare(shifted.astype(np.uint8)).shift
        assert 0.4 * pixels / 128 < shift < 1.2 * pixels / 128


@pytest.mark.parametrize("size", [40, 128, 200])
def test_the_displacement_by_itself_is_that_of_the_whole_comparison(size: int) -> None:
    image = planar_images(np.zeros((1, 6)), size, seed=0)[0]
    view = ReferenceView(image)
    for other in (_noisy(image, 3.0), np.roll(image, 1, axis=1), np.rot90(image).copy()):
        assert view.shift(other) == view.compare(other).shift


@given(arrays(float, st.tuples(st.integers(1, 8), st.integers(1, 8)), elements=st.floats(0, 255)))
def test_the_quantile_of_a_contrast_is_that_of_numpy(contrast) -> None:
    assert _quantile(contrast, 0.9) == pytest.approx(np.quantile(contrast, 0.9), abs=1e-12)


def test_gain_and_offset_do_not_matter_to_what_matches_but_to_what_is_equal() -> None:
    dim = (0.6 * IMAGE + 20).round().astype(np.uint8)
    compared = VIEW.compare(dim)
    assert compared.matched == 1
    assert compared.shift < 1e-3
    assert not arrival.is_equal(compared)


def test_what_is_covered_does_not_match() -> None:
    covered = IMAGE.copy()
    covered[:, :64] = np.random.default_rng(0).integers(0, 256, (128, 64), dtype=np.uint8)
    assert VIEW.compare(covered).matched == pytest.approx(0.5, abs=0.1)


def test_pixels_clipped_in_the_reference_too_are_usable() -> None:
    bright = np.clip(IMAGE * 1.6, 0, 255).astype(np.uint8)
    clipped = (bright == 255).mean()
    assert 0.05 < clipped < 0.7
    assert VIEW.usable(bright) == pytest.approx(1 - clipped, abs=0.01)
    assert ReferenceView(bright).usable(bright) == 1


def test_similarity_is_that_of_related_and_unrelated_images() -> None:
    one, other = (np.random.default_rng(s).normal(size=(64, 64)).astype("float32") for s in (0, 1))
    assert similarity(2 * one - 3, one) == pytest.approx(1)
    assert abs(similarity(other, one)) < 0.2
    assert similarity(one, np.ones_like(one)) == 0
