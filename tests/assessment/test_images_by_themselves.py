"""Pixel noise and repetition, told from images alone."""

import cv2
import numpy as np
import pytest

from planar import planar_data_set
from servoscope.assessment.image_facts import describe_images, find_repetition
from servoscope.data.pixel_noise import estimate_pixel_noise


def scenery(sigma, shape=(240, 320), seed=0):
    noise = np.random.default_rng(seed).normal(size=shape).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), sigma)
    return cv2.normalize(smooth, None, 30, 220, cv2.NORM_MINMAX)


@pytest.mark.parametrize("sigma", [1.0, 2.0, 5.0, 10.0])
def test_the_noise_of_smooth_scenery_is_found(sigma):
    noise = np.random.default_rng(1).normal(0, sigma, (240, 320))
    image = np.clip(scenery(8) + noise, 0, 255).round().astype(np.uint8)
    assert estimate_pixel_noise(image) == pytest.approx(sigma, rel=0.12)


def test_half_of_the_view_full_of_texture_does_not_hide_the_noise():
    image = scenery(20) + np.random.default_rng(1).normal(0, 2, (240, 320))
    image[:, :160] += 60 * np.random.default_rng(2).normal(size=(240, 160))
    assert estimate_pixel_noise(np.clip(image, 0, 255).astype(np.uint8)) < 3


@pytest.mark.parametrize("grey", [0, 255])
def test_black_and_white_images_tell_no_noise(grey):
    assert estimate_pixel_noise(np.full((32, 32), grey, np.uint8)) == 0.0


@pytest.mark.parametrize("period", [12, 20, 33])
def test_a_row_of_holes_repeats_at_its_period(period):
    y, x = np.mgrid[:240, :320]
    holes = np.hypot(x % period - period / 2, y - 120) < period / 4
    noise = np.random.default_rng(0).normal(0, 10, holes.shape)
    found = find_repetition(np.clip(120 + 80 * holes + noise, 0, 255).astype(np.uint8))
    assert found.repeats
    shift = abs(found.shift[0])
    assert min(shift % period, -shift % period) <= 320 / 128
    assert abs(found.shift[1]) <= 320 / 128


@pytest.mark.parametrize("sigma", [1, 3, 8])
@pytest.mark.parametrize("seed", range(3))
def test_scenery_without_a_pattern_does_not_repeat(sigma, seed):
    assert not find_repetition(scenery(sigma, seed=seed).astype(np.uint8)).repeats


def test_a_likeness_that_goes_on_where_the_shifts_end_is_no_repetition():
    assert not find_repetition(planar_data_set(2, 24).reference_image).repeats


@pytest.mark.parametrize("shape", [(1, 1), (2, 50), (64, 64), (1, 500)])
def test_flat_images_do_not_repeat(shape):
    assert not find_repetition(np.full(shape, 77, np.uint8)).repeats


def test_noise_is_looked_for_in_few_images(monkeypatch):
    looked_at = []
    monkeypatch.setattr(
        "servoscope.assessment.image_facts.estimate_pixel_noise",
        lambda image: looked_at.append(image) or 1.0,
    )
    describe_images(planar_data_set(59, 16))
    assert 20 <= len(looked_at) <= 30


def test_copies_are_counted_and_no_change_is_seen():
    data = planar_data_set(12, 16)
    images = data.images.copy()
    assert describe_images(data).n_copies == 0
    images[5:8] = images[2]
    from dataclasses import replace

    facts = describe_images(replace(data, images=images))
    assert (facts.n_copies, facts.change) == (3, True)
    frozen = np.repeat(images[:1], 12, axis=0)
    assert not describe_images(replace(data, images=frozen)).change
