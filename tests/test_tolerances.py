"""Tolerances as people write them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from servoscope.dofs import parse_tolerances
from servoscope.errors import InvalidInputError
from servoscope.poses import DOFS


def test_units_are_brought_to_mm_and_degrees():
    tolerances = parse_tolerances("tx=0.5mm, ty=200um,tz=1e-3m,rx=0.1deg,ry=1mrad,rz=0.01rad")
    assert tolerances == pytest.approx(
        dict(zip(DOFS, (0.5, 0.2, 1.0, 0.1, np.degrees(0.001), np.degrees(0.01)), strict=True))
    )


def test_nothing_is_wished_by_nothing():
    assert parse_tolerances("") == parse_tolerances(" , ") == {}


def test_a_letter_stands_for_all_three_of_a_kind():
    assert parse_tolerances("r=2deg") == {"rx": 2.0, "ry": 2.0, "rz": 2.0}


@given(st.dictionaries(st.sampled_from(DOFS), st.floats(1e-3, 1e3)))
def test_what_was_written_is_read(asked):
    text = ",".join(f"{dof}={v!r}{'mm' if dof[0] == 't' else 'deg'}" for dof, v in asked.items())
    assert parse_tolerances(text) == asked


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("tx", "written like tx=0.5mm"),
        ("tx=0.5", "written like tx=0.5mm"),
        ("tx=0mm", "positive number"),
        ("tx=-1mm", "positive number"),
        ("tx=nanmm", "written like"),
        ("tx=1e999mm", "positive number"),
        ("tx=--mm", "positive number"),
        ("q=1mm", "one of tx, ty"),
        ("tx=1deg", "tolerance of tx is in mm or um or m, got 'tx=1deg'"),
        ("rz=1mm", "tolerance of rz is in deg"),
        ("tx=1mm,t=2mm", "tx is named twice"),
    ],
)
def test_what_is_no_tolerance_is_refused_in_one_line(text, said):
    with pytest.raises(InvalidInputError, match=said) as refused:
        parse_tolerances(text)
    assert "\n" not in str(refused.value)
