"""Trajectories against their own derivatives, taken numerically."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from servoscope.robots.arm_motion import ACCELERATION, SPEED, minimum_jerk

STEP = 1e-3


@given(st.floats(1e-3, 6.0), st.floats(-1.0, 1.0))
def test_speed_and_acceleration_are_kept(far: float, less: float) -> None:
    start, goal = np.array([0.5, -0.2]), np.array([0.5 + far, -0.2 + less * far])
    course = np.concatenate([[start] * 2, minimum_jerk(start, goal, STEP), [goal] * 2])
    speed = np.diff(course, axis=0) / STEP
    assert np.abs(speed).max() <= SPEED * (1 + 1e-9)
    assert np.abs(np.diff(speed, axis=0)).max() / STEP <= ACCELERATION * (1 + 1e-6)


@pytest.mark.parametrize(("far", "what"), [(0.2, "acceleration"), (3.0, "speed")])
def test_no_time_is_wasted(far: float, what: str) -> None:
    course = np.concatenate([np.zeros((2, 1)), minimum_jerk(np.zeros(1), np.full(1, far), STEP)])
    speed = np.diff(course[:, 0]) / STEP
    fastest = {"speed": speed.max() / SPEED, "acceleration": np.diff(speed).max() / STEP}
    fastest["acceleration"] /= ACCELERATION
    assert fastest[what] > 0.98


def test_it_ends_at_the_goal_exactly_and_stays_when_there_is_nothing_to_do() -> None:
    goal = np.array([0.1, 0.7, -0.3])
    np.testing.assert_array_equal(minimum_jerk(np.zeros(3), goal, STEP)[-1], goal)
    np.testing.assert_array_equal(minimum_jerk(goal, goal, STEP), [goal])
