"""The sensor: noise, blur, vignetting and the conversion to grey levels, each against its model."""

from dataclasses import Field, fields

import numpy as np
import pytest

from servoscope.errors import InvalidInputError
from servoscope.scene.sensor import Sensor

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
def test_numbers_that_are_not_finite_are_refused(field: Field[float], value: float) -> None:
    with pytest.raises(InvalidInputError, match=f"{field.name} must be a finite number, got"):
        Sensor(**{field.name: value})


def test_the_strongest_vignetting_leaves_the_corners_black_and_defined(
    rng: np.random.Generator,
) -> None:
    sensor = Sensor(vignetting=1.0, blur=0.0, read_noise=0.0)
    image = sensor.read_out(_flat(0.9, 255), rng)
    assert image[127, 127] > 200
    assert image[[0, 0, -1, -1], [0, -1, 0, -1]].max() < 10
