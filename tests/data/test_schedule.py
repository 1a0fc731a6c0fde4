"""Schedules are read as they are written, and wrong ones are refused in one line."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from servoscope.data.schedule import RECOMMENDED, check_schedule, format_schedule, parse_schedule
from servoscope.errors import InvalidInputError

RINGS = st.tuples(st.integers(1, 1000), st.floats(0, 4, exclude_min=True))


@given(st.lists(RINGS, min_size=1, max_size=6))
def test_what_is_written_is_read(rings: list[tuple[int, float]]) -> None:
    assert parse_schedule(format_schedule(rings)) == tuple(rings)


def test_blanks_and_whole_factors_are_understood() -> None:
    assert parse_schedule(" 1000@1.0, 400@.2 ,5@4") == ((1000, 1.0), (400, 0.2), (5, 4.0))


def test_default_is_the_recommended_one() -> None:
    assert parse_schedule("default") == RECOMMENDED == check_schedule(RECOMMENDED)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "rings of images@factor, .*; got ''"),
        ("1000", "got '1000'"),
        ("1000@", "got '1000@'"),
        ("@1", "got '@1'"),
        ("5@1,", "got ''"),
        ("5@1;4@2", "got '5@1;4@2'"),
        ("5@1@2", "got '5@1@2'"),
        ("1e3@1", "got '1e3@1'"),
        ("best", "got 'best'"),
        ("-5@1", "from 1 to 1000000, got -5"),
        ("0@1", "from 1 to 1000000, got 0"),
        ("5@0", r"above 0 and at most 4, got 0\.0"),
        ("5@-1", r"above 0 and at most 4, got -1\.0"),
        ("5@nan", "above 0 and at most 4, got nan"),
        ("5@inf", "above 0 and at most 4, got inf"),
        ("5@4.01", r"above 0 and at most 4, got 4\.01"),
        ("1000001@1", "from 1 to 1000000, got 1000001"),
        ("600000@1,600000@0.2", "at most 1000000 images, got 1200000"),
    ],
)
def test_wrong_schedules_are_refused(text: str, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message) as caught:
        parse_schedule(text)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("schedule", "message"),
    [
        (5, "must be pairs"),
        ([5], "must be pairs"),
        ([(5,)], "must be pairs"),
        ([(5, 1.0, 2)], "must be pairs"),
        ([(5.0, 1.0)], "whole number of images"),
        ([(5, None)], "factor must be"),
        ([(5, "1")], "factor must be"),
    ],
)
def test_what_is_no_schedule_is_refused(schedule: object, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        check_schedule(schedule)  # type: ignore[arg-type]
