"""Lamps that stand elsewhere, on reliefs whose light is known."""

import numpy as np
import pytest

from rehearsal_sample import keyframe
from servoscope.rehearsal.rendered_cell import light_change
from servoscope.scene.lighting import Lighting, PointLight

ABOVE = Lighting((PointLight((0.0, 0.0, 1.0), 1.0),), ambient=0.0)
EVEN = Lighting((), ambient=1.0)


def test_the_same_lamps_change_nothing():
    assert light_change(keyframe(), ABOVE, ABOVE, 0.7) == pytest.approx(1.0)


def test_light_falls_off_with_distance_and_angle():
    """On a plane under a lamp at height h, cos(a) / r^2 = h / (h^2 + x^2)^(3/2)."""
    change = light_change(keyframe(), EVEN, ABOVE, 0.0)
    middle, corner = change[48, 64], change[2, 2]
    # the view is 1 / 1.5 of the standoff wide, and 3 / 4 of that high
    x, y = 0.55 / 1.5 * np.array([61.5 / 128, 45.5 / 128])
    assert middle == pytest.approx(1.0, abs=0.01)
    assert corner == pytest.approx((1 + x**2 + y**2) ** -1.5, abs=0.01)


def test_a_block_throws_its_shadow_away_from_the_lamp():
    relief = np.full((48, 64), 2.0)
    relief[16:32, 24:40] = 2.4
    aside = Lighting((PointLight((-1.0, 0.0, 0.8), 1.0),), ambient=0.2)
    change = light_change(keyframe(relief), EVEN, aside, 0.0)
    behind, before = change[40:56, 86:92].mean(), change[40:56, 36:42].mean()
    assert behind < 0.5 * before


def test_lamps_turned_by_half_a_turn_throw_shadows_the_other_way():
    relief = np.full((48, 64), 2.0)
    relief[16:32, 24:40] = 2.4
    aside = Lighting((PointLight((-1.0, 0.0, 0.8), 1.0),), ambient=0.2)
    change = light_change(keyframe(relief), EVEN, aside, np.pi)
    assert change[40:56, 36:42].mean() < 0.5 * change[40:56, 86:92].mean()
