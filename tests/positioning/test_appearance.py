"""Images are smoothed by as much as is told, however they are shrunk."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from servoscope.errors import InvalidInputError
from servoscope.positioning.appearance import Appearance

WIDTH = 256


def wave(cycles: float, columns: int) -> np.ndarray:
    """A sine along a row, seen at the centres of as many columns."""
    x = (np.arange(columns) + 0.5) / columns
    return np.sin(2 * np.pi * cycles * x)


def amplitude(blur: float, cycles: float, high_pass: float = 0.0) -> float:
    """What is left of a sine of amplitude 1, away from the borders."""
    prepared = Appearance(blur, high_pass).prepare(np.tile(wave(cycles, WIDTH), (64, 1)))
    middle = slice(prepared.shape[1] // 4, -(prepared.shape[1] // 4))
    seen, expected = prepared[len(prepared) // 2, middle], wave(cycles, prepared.shape[1])[middle]
    return float(seen @ expected / (expected @ expected))


def attenuation(sigma: float, cycles: float) -> float:
    """Of a sine by a Gaussian of a standard deviation in image widths."""
    return float(np.exp(-((2 * np.pi * cycles * sigma) ** 2) / 2))


@pytest.mark.parametrize("blur", [1 / 256, 3 / 256, 8 / 256, 16 / 256, 24 / 256])
@pytest.mark.parametrize("angle", [0.4, 0.8, 1.2])
def test_a_sine_is_attenuated_as_by_a_gaussian_and_by_the_pixels_themselves(blur, angle) -> None:
    cycles = angle / (2 * np.pi * blur)
    columns = Appearance(blur).shape((64, WIDTH))[1]
    expected = attenuation(blur, cycles) * np.sinc(cycles / columns)
    assert amplitude(blur, cycles) == pytest.approx(expected, rel=0.07)


@pytest.mark.parametrize("blur", [3 / 256, 12 / 256])
@pytest.mark.parametrize("angle", [0.2, 0.6, 1.0])
def test_the_high_pass_subtracts_a_wider_gaussian(blur, angle) -> None:
    cycles = angle / (2 * np.pi * blur)
    expected = attenuation(blur, cycles) - attenuation(4 * blur, cycles)
    assert amplitude(blur, cycles, 4 * blur) == pytest.approx(expected, abs=0.06)


sizes = st.tuples(st.integers(1, 300), st.integers(1, 600))
blurs = st.floats(1 / 256, 0.2)


@given(sizes, blurs, st.integers(0, 255))
def test_a_constant_image_stays_constant_and_passes_no_high_pass(size, blur, grey) -> None:
    image = np.full(size, grey, np.uint8)
    np.testing.assert_allclose(Appearance(blur).prepare(image), grey, atol=1e-3)
    np.testing.assert_allclose(Appearance(blur, 4 * blur).prepare(image), 0, atol=1e-3)


@given(sizes, blurs)
def test_prepared_images_have_the_shape_that_is_told_and_are_no_larger(size, blur) -> None:
    appearance = Appearance(blur)
    prepared = appearance.prepare(np.zeros(size, np.uint8))
    assert prepared.shape == appearance.shape(size)
    assert prepared.dtype == np.float32
    assert (np.array(prepared.shape) <= size).all()


@pytest.mark.parametrize(
    ("size", "blur", "shape"),
    [
        ((256, 256), 1 / 256, (128, 128)),
        ((256, 256), 1 / 64, (64, 64)),
        ((256, 256), 0.09, (24, 24)),
        ((240, 320), 1 / 40, (30, 40)),
        ((480, 640), 1 / 256, (192, 256)),
        ((40, 400), 1 / 50, (5, 50)),
        ((400, 40), 1 / 50, (240, 24)),
        ((12, 16), 1 / 256, (12, 16)),
        ((1, 300), 0.1, (1, 24)),
    ],
)
def test_pixels_are_about_as_wide_as_the_blur(size, blur, shape) -> None:
    assert Appearance(blur).shape(size) == shape


@pytest.mark.parametrize(
    ("blur", "high_pass"),
    [(0, 0), (-0.1, 0), (1, 0), (np.nan, 0), (0.1, 0.1), (0.1, 0.05), (0.1, 1), (0.1, np.nan)],
)
def test_blurs_that_make_no_sense_are_refused(blur, high_pass) -> None:
    with pytest.raises(InvalidInputError, match="blur must lie between 0 and 1 image widths"):
        Appearance(blur, high_pass)
