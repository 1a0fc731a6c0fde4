"""Where an error doubles, and where prediction and simulation part."""

import json

import pytest

from servoscope.sensitivity import ErrorGrowth
from servoscope.sensitivity.measurement import first_reached


def growth(simulated, predicted, strengths=(-2.0, -1.0, 1.0, 2.0), clean=1.0):
    return ErrorGrowth(strengths, "px", simulated, predicted, (0.0,) * 4, clean, "mm")


def test_the_error_doubles_at_the_smaller_of_both_signs():
    assert growth((9.0, 2.0, 1.0, 1.5), (0.0,) * 4).doubles_at == pytest.approx(1.0)
    assert growth((1.0, 1.0, 1.5, 2.0), (0.0,) * 4).doubles_at == pytest.approx(2.0)


@pytest.mark.parametrize("power", [1, 2])
def test_the_doubling_of_errors_that_grow_to_first_order_is_exact(power):
    """``clean^2 + (slope strength^power)^2 = 4 clean^2``, solved for the strength."""
    strengths, clean, slope = (1.0, 2.0, 5.0), 3.0, 2.0
    rms = tuple((clean**2 + (slope * s**power) ** 2) ** 0.5 for s in strengths)
    got = ErrorGrowth(strengths, "px", rms, rms, (0.0,) * 3, clean, "mm", power)
    assert got.doubles_at == pytest.approx((3**0.5 * clean / slope) ** (1 / power))


def test_an_error_that_never_doubles_has_no_strength():
    assert growth((1.9, 1.0, 1.0, 1.9), (0.0,) * 4).doubles_at is None


def test_prediction_and_simulation_part_where_they_differ_by_a_fifth():
    same = (5.0, 1.0, 1.0, 5.0)
    assert growth(same, same).parts_at is None
    assert growth(same, (5.0, 1.0, 1.0, 3.0)).parts_at == pytest.approx(1.5)
    assert growth(same, (7.0, 1.0, 1.0, 5.0)).parts_at == pytest.approx(1.5)


def test_what_is_reached_and_left_again_counts():
    assert first_reached((1.0, 2.0, 3.0), (4.0, 0.0, 0.0), start=0.0, level=2.0) == 0.5


def test_the_dict_is_plain_json():
    values = json.loads(json.dumps(growth((2.0,) * 4, (2.0,) * 4).to_dict(), allow_nan=False))
    assert values["strengths"] == [-2.0, -1.0, 1.0, 2.0]
    assert values["doubles_at"] == 1.0
    assert values["parts_at"] is None
