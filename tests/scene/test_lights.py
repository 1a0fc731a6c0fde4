"""Lamps and ambient light are finite, and take no light away."""

import math

import pytest

from servoscope.errors import InvalidInputError
from servoscope.scene.lights import Lighting, PointLight


@pytest.mark.parametrize("bad", [math.nan, math.inf, -1.0])
def test_strengths_and_ambient_light_that_cannot_be_are_refused(bad: float) -> None:
    with pytest.raises(InvalidInputError, match="strength must be finite and not negative, got"):
        PointLight((0.0, 0.0, 1.0), bad)
    with pytest.raises(InvalidInputError, match="ambient must be finite and not negative, got"):
        Lighting(ambient=bad)


@pytest.mark.parametrize("position", [(0.0, math.nan, 1.0), (math.inf, 0.0, 1.0), (0.0, 1.0)])
def test_places_that_cannot_be_are_refused(position: tuple[float, ...]) -> None:
    with pytest.raises(InvalidInputError, match="position must be 3 finite numbers, got"):
        PointLight(position, 1.0)
