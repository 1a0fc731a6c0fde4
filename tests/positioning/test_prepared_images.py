"""Prepared images: what they do not see, and what they do."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planar import planar_images
from servoscope.features import Eigenfeatures, GeometricMoments
from servoscope.positioning.prepared_images import PREPARATIONS

NORMALISED = ["local", "gradient", "orientation"]
IMAGE = planar_images(np.zeros((1, 6)), 64, seed=3)[0] // 2


@pytest.mark.parametrize("name", NORMALISED)
@given(gain=st.sampled_from([1, 2]), offset=st.integers(0, 1))
def test_neither_gain_nor_offset_changes_a_normalised_image(name, gain, offset) -> None:
    prepare = PREPARATIONS[name]
    np.testing.assert_allclose(prepare(gain * IMAGE + np.uint8(offset)), prepare(IMAGE), atol=1e-5)


@pytest.mark.parametrize("name", ["grey", *NORMALISED])
@pytest.mark.parametrize("shape", [(64, 64), (48, 64), (300, 200), (12, 20)])
def test_a_prepared_image_has_unit_length_whatever_its_shape(name, shape) -> None:
    prepared = PREPARATIONS[name](cv2.resize(IMAGE, shape[::-1]))
    assert prepared.dtype == np.float32
    assert np.linalg.norm(prepared) == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize("name", PREPARATIONS)
@pytest.mark.parametrize("level", [0, 128, 255])
def test_an_image_without_anything_in_it_gives_finite_numbers(name, level) -> None:
    assert np.isfinite(PREPARATIONS[name](np.full((64, 64), level, np.uint8))).all()


@pytest.mark.parametrize(("angle", "direction"), [(0, 0), (90, 2), (180, 4), (225, 5), (315, 7)])
def test_orientations_tell_the_direction_of_a_ramp(angle: int, direction: int) -> None:
    rows, columns = np.mgrid[:64, :64] - 31.5
    along = np.cos(np.radians(angle)) * columns + np.sin(np.radians(angle)) * rows
    votes = PREPARATIONS["orientation"]((128 + along).round().astype(np.uint8))
    assert votes.reshape(8, 64).sum(axis=1).argmax() == direction


def test_orientations_tell_the_place_of_an_edge() -> None:
    image = np.zeros((64, 64), np.uint8)
    image[:, 36:] = 200
    votes = PREPARATIONS["orientation"](image).reshape(8, 8, 8)
    assert (votes[0].argmax(axis=1) == 4).all()
    assert votes[4].max() < 1e-3


def test_a_covering_changes_local_features_near_it_only() -> None:
    covered = IMAGE.copy()
    covered[8:20, 8:20] = 200
    before, after = (PREPARATIONS["local"](image).reshape(32, 32) for image in (IMAGE, covered))
    a, b = before[20:, 20:], after[20:, 20:]
    np.testing.assert_allclose(b / np.linalg.norm(b), a / np.linalg.norm(a), atol=0.02)


def test_the_moments_are_those_of_the_paper() -> None:
    expected = GeometricMoments().fit_transform(IMAGE[None])[0]
    np.testing.assert_allclose(PREPARATIONS["moments"](IMAGE), expected, rtol=1e-6, atol=1e-6)


def test_the_grey_image_keeps_what_eigenfeatures_see() -> None:
    delta_p = np.random.default_rng(0).uniform(-0.02, 0.02, (60, 6))
    images = planar_images(delta_p, 256, seed=3)
    full = Eigenfeatures(5).fit_transform(images)
    small = Eigenfeatures(5).fit_transform([PREPARATIONS["grey"](image) for image in images])
    for i in range(5):
        assert abs(np.corrcoef(full[:, i], small[:, i])[0, 1]) > 0.99
