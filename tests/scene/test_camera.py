"""The lens projects as OpenCV does, the sensor counts light, and a covering hides what it says."""

from dataclasses import Field, fields, replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from servoscope.errors import InvalidInputError
from servoscope.poses import rigid_transform
from servoscope.scene.camera import Covering, Lens, Sensor
from servoscope.scene.render import render, render_radiance
from servoscope.scene.scene import T_WORLD_REF, Scene
from servoscope.scene.textured_plane import TexturedPlane

fractions = st.floats(0.0, 1.0)


@given(fractions, fractions, st.floats(-0.15, 0.3), st.floats(0.0, 0.1))
def test_a_point_on_the_ray_of_a_pixel_is_seen_there(
    u: float, v: float, k1: float, k2: float
) -> None:
    lens = Lens(distortion=(k1, k2))
    pixel = np.array([u, v]) * 256 - 0.5
    seen = lens.project(0.7 * lens.rays(pixel, 256), 256)
    np.testing.assert_allclose(seen, pixel, atol=1e-9)


@given(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(0.3, 2.0))
def test_projection_is_that_of_opencv(x: float, y: float, z: float) -> None:
    lens = Lens()
    K, still = lens.camera_matrix(256), np.zeros(3)
    point = np.array([x * z, y * z, z])
    expected, _ = cv2.projectPoints(point, still, still, K, np.array([*lens.distortion, 0, 0]))
    np.testing.assert_allclose(lens.project(point, 256), expected.ravel(), atol=1e-8)


def test_images_of_every_size_show_the_same_view() -> None:
    lens = Lens()
    small, large = lens.rays([-0.5, 31.5], 32), lens.rays([-0.5, 511.5], 512)
    np.testing.assert_allclose(small, large, atol=1e-12)


def test_a_lens_that_folds_the_image_over_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="folds the image over"):
        Lens(distortion=(-2.0, 0.0))


@pytest.mark.parametrize("focal_length", [0.0, -1.0])
def test_a_focal_length_that_is_not_positive_is_refused(focal_length: float) -> None:
    with pytest.raises(InvalidInputError, match="focal_length must be positive"):
        Lens(focal_length=focal_length)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("focal_length", np.inf),
        ("focal_length", np.nan),
        ("principal_point", (np.nan, 0.5)),
        ("distortion", (0.0, np.nan)),
    ],
)
def test_numbers_that_are_not_finite_are_refused(name: str, value: object) -> None:
    with pytest.raises(InvalidInputError, match=f"{name} must be finite, got"):
        Lens(**{name: value})


PLAIN = Sensor(exposure=1.0, vignetting=0.0, blur=0.0)


def _flat(level: float, size: int = 256) -> np.ndarray:
    return np.full((size, size), level, np.float32)


def test_grey_is_proportional_to_light_and_saturates() -> None:
    levels = [PLAIN.read_out(_flat(level, 16))[0, 0] for level in (0.0, 0.2, 0.6, 1.0, 1.5)]
    assert levels == [0, 51, 153, 255, 255]


def test_exposure_and_gain_multiply_the_grey_level() -> None:
    brighter = Sensor(exposure=1.5, gain=2.0, vignetting=0.0, blur=0.0)
    assert brighter.read_out(_flat(0.2, 16))[0, 0] == 153


@pytest.mark.parametrize("level", [0.05, 0.2, 0.5, 0.8])
@pytest.mark.parametrize("gain", [0.5, 1.0])
def test_variance_is_that_of_photons_reading_and_rounding(
    level: float, gain: float, rng: np.random.Generator
) -> None:
    sensor = Sensor(1.0, gain, vignetting=0.0, blur=0.0, full_well=2_000.0, read_noise=20.0)
    image = sensor.read_out(_flat(level), rng).astype(float)
    grey_per_electron = 255 * gain / sensor.full_well
    electrons = level * sensor.full_well
    variance = grey_per_electron**2 * (electrons + sensor.read_noise**2) + 1 / 12
    assert image.mean() == pytest.approx(255 * gain * level, abs=0.1)
    assert image.var() == pytest.approx(variance, rel=0.04)


def test_corners_lose_the_light_that_vignetting_states() -> None:
    image = Sensor(exposure=1.0, vignetting=0.4, blur=0.0).read_out(_flat(0.8, 255))
    assert image[127, 127] == 204
    assert image[0, 0] == pytest.approx(0.6 * 204, abs=2)
    assert image[0, 127] == pytest.approx(0.8 * 204, abs=2)


def test_blur_spreads_a_step_as_a_gaussian_does() -> None:
    from scipy.stats import norm

    step = _flat(0.0, 128)
    step[:, 64:] = 0.9
    image = Sensor(exposure=1.0, vignetting=0.0, blur=3.0 / 128).read_out(step)
    expected = 255 * 0.9 * norm.cdf((np.arange(128) - 63.5) / 3.0)
    np.testing.assert_allclose(image[64], expected, atol=2.0)


def test_without_a_generator_there_is_no_noise(rng: np.random.Generator) -> None:
    light = rng.random((32, 32), np.float32)
    np.testing.assert_array_equal(Sensor().read_out(light), Sensor().read_out(light))


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("exposure", 0.0, "exposure must be positive, got 0.0"),
        ("gain", -1.0, "gain must be positive"),
        ("full_well", -1.0, "full_well must be positive"),
        ("blur", -0.1, "blur must not be negative"),
        ("read_noise", -1.0, "read_noise must not be negative"),
        ("vignetting", -0.1, "vignetting must not be negative"),
        ("vignetting", 3.0, "vignetting must be at most 1, got 3.0"),
    ],
)
def test_numbers_out_of_range_are_refused(name: str, value: float, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        Sensor(**{name: value})


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("field", fields(Sensor))
def test_a_sensor_s_numbers_are_finite(field: Field[float], value: float) -> None:
    with pytest.raises(InvalidInputError, match=f"{field.name} must be a finite number, got"):
        Sensor(**{field.name: value})


def test_the_strongest_vignetting_leaves_the_corners_black_and_defined(
    rng: np.random.Generator,
) -> None:
    sensor = Sensor(vignetting=1.0, blur=0.0, read_noise=0.0)
    image = sensor.read_out(_flat(0.9, 255), rng)
    assert image[127, 127] > 200
    assert image[[0, 0, -1, -1], [0, -1, 0, -1]].max() < 10


def hidden_by(covering: Covering, size: int = 100) -> np.ndarray:
    return covering.cover(np.full((size, size), -1.0)) >= 0


@pytest.mark.parametrize("share", [0.0, 0.1, 0.2, 0.5, 0.93, 1.0])
def test_a_rectangle_of_the_share_is_hidden_to_half_a_row(share: float) -> None:
    for seed in range(20):
        hidden = hidden_by(Covering(share, seed))
        height, width = hidden.any(axis=1).sum(), hidden.any(axis=0).sum()
        assert hidden.sum() == height * width
        assert abs(hidden.sum() - share * 100**2) <= width / 2


def test_it_stays_in_the_image_when_the_camera_moves_and_the_sensor_adds_its_noise() -> None:
    scene = Scene(TexturedPlane(), sensor=Sensor(blur=0.0), image_size=64)
    covered = replace(scene, covering=Covering(0.3, seed=3))
    hidden = hidden_by(covered.covering, 64)
    shifted = T_WORLD_REF @ rigid_transform(np.eye(3), [0.02, 0.01, 0.0])
    here, there = (render_radiance(covered, T) for T in (T_WORLD_REF, shifted))
    assert len({*here[hidden], *there[hidden]}) == 1
    np.testing.assert_array_equal(here[~hidden], render_radiance(scene, T_WORLD_REF)[~hidden])
    assert render(covered, T_WORLD_REF, np.random.default_rng(0))[hidden].std() > 0.5


def test_another_seed_hangs_it_elsewhere_in_another_grey() -> None:
    first, again, other = (Covering(0.2, s).cover(np.zeros((64, 64))) for s in (0, 0, 1))
    np.testing.assert_array_equal(first, again)
    assert (first != other).mean() > 0.2


@pytest.mark.parametrize("share", [-0.1, 1.1, float("nan")])
def test_shares_out_of_range_are_refused(share: float) -> None:
    with pytest.raises(InvalidInputError, match="share must be from 0 to 1, got"):
        Covering(share)


@pytest.mark.parametrize("seed", [-1, 0.5])
def test_seeds_that_are_no_count_are_refused(seed: float) -> None:
    with pytest.raises(InvalidInputError, match="seed must be a whole number from 0"):
        Covering(0.1, seed)
