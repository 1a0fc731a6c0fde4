"""Lamps shine, and light falls off across the view."""

import math

import numpy as np
import pytest

from servoscope.errors import InvalidInputError
from servoscope.scene.lighting import Falloff, Lighting, PointLight
from servoscope.scene.render import render
from servoscope.scene.scene import T_WORLD_REF, Scene
from servoscope.scene.textured_plane import TexturedPlane


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


def test_light_falls_evenly_between_its_factors_and_is_kept_in_the_middle_between_them():
    shaded = Falloff(1.2, 0.6, seed=3).shade(np.ones((41, 61)))
    assert shaded.max() == pytest.approx(1.2)
    assert shaded.min() == pytest.approx(0.6)
    assert shaded[20, 30] == pytest.approx(0.9)
    np.testing.assert_allclose(np.diff(shaded, 2, axis=0), 0, atol=1e-12)
    np.testing.assert_allclose(np.diff(shaded, 2, axis=1), 0, atol=1e-12)


def test_each_seed_has_a_direction_of_its_own_and_keeps_it():
    one, other = (Falloff(1.0, 0.5, seed).shade(np.ones((9, 9))) for seed in (1, 2))
    assert not np.allclose(one, other)
    np.testing.assert_array_equal(one, Falloff(1.0, 0.5, 1).shade(np.ones((9, 9))))


def test_an_image_of_a_scene_is_darker_in_proportion():
    plain = Scene(part=TexturedPlane(), image_size=64)
    halved = Scene(part=TexturedPlane(), image_size=64, falloff=Falloff(0.5, 0.5))
    before, after = (render(scene, T_WORLD_REF).astype(float) for scene in (plain, halved))
    np.testing.assert_allclose(after, before / 2, atol=1.0)


@pytest.mark.parametrize("factors", [(-0.1, 1.0), (1.0, np.inf), (np.nan, 1.0)])
def test_impossible_factors_are_refused(factors):
    with pytest.raises(InvalidInputError, match="finite factors"):
        Falloff(*factors)
