"""A plan goes little way, never far at once, and never out of the workspace."""

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from servoscope.acquisition.plan import Draws, Plan, travel_order, waypoints
from servoscope.data.schedule import Ring
from servoscope.errors import InvalidInputError
from servoscope.poses import pose_error, poses_from_displacements, rigid_transform
from servoscope.positioning.workspace import Workspace

PIVOT = 0.4
RANGES = np.array([0.02] * 3 + [np.radians(10)] * 3)
T_REF = rigid_transform(
    Rotation.from_euler("xyz", [170, 5, 30], degrees=True).as_matrix(), [0.5, 0.1, 0.4]
)


def plan(n: int = 40, seed: int = 0, **options) -> Plan:
    return Plan.draw(Draws((Ring(n, 1.6),), RANGES, seed), T_REF, pivot=PIVOT, **options)


def way(T: np.ndarray, order, metric: float = PIVOT) -> float:
    every = np.concatenate([T_REF[None], T[list(order)], T_REF[None]])
    distances, angles = pose_error(every[:-1], every[1:])
    return float(np.hypot(distances, metric * angles).sum())


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 99))
def test_the_way_through_few_poses_is_nearly_the_shortest(seed: int) -> None:
    delta_p = np.random.default_rng(seed).uniform(-1, 1, (6, 6)) * RANGES
    T = poses_from_displacements(T_REF, delta_p, PIVOT)
    found = travel_order(T, T_REF, PIVOT)
    assert sorted(found) == list(range(6))
    assert way(T, found) < 1.1 * min(way(T, order) for order in permutations(range(6)))


def test_the_way_through_many_is_far_shorter_than_as_they_are_drawn() -> None:
    many = plan(300)
    assert sorted(many.order) == list(range(300))
    assert way(many.poses, many.order) < 0.6 * way(many.poses, range(300))


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 99), most=st.floats(0.005, 0.1), angle=st.floats(0.02, 0.5))
def test_steps_are_short_straight_and_arrive(seed: int, most: float, angle: float) -> None:
    delta_p = np.random.default_rng(seed).uniform(-1, 1, (2, 6)) * RANGES
    start, end = poses_from_displacements(T_REF, delta_p, PIVOT)
    steps = np.concatenate([start[None], waypoints(start, end, most, angle)])
    distances, angles = pose_error(steps[:-1], steps[1:])
    assert distances.max() <= most * (1 + 1e-9)
    assert angles.max() <= angle * (1 + 1e-6)
    np.testing.assert_array_equal(steps[-1], end)
    line = end[:3, 3] - start[:3, 3]
    off = np.linalg.norm(np.cross(steps[:, :3, 3] - start[:3, 3], line), axis=1)
    assert off.max() < 1e-9


def test_the_reference_is_seen_again_in_between_and_at_the_end() -> None:
    stops = plan(40, check_every=15).stops()
    assert [k for k, stop in enumerate(stops) if stop is None] == [15, 31, 42]
    assert plan(40, check_every=20).stops().count(None) == 2


def test_every_pose_of_the_way_is_within_the_workspace() -> None:
    box = Workspace.parse("x=490:1000,y=80:120,z=390:1000")
    inside = plan(workspace=box)
    assert inside.n_outside > 40
    assert box.holds(inside.path)
    free = plan()
    assert not box.holds(free.path)
    kept = [i for i in range(40) if box.holds(free.poses[i])]
    np.testing.assert_array_equal(inside.poses[kept], free.poses[kept])
    with pytest.raises(InvalidInputError, match="reports to be at"):
        plan(workspace=Workspace.parse("z=0:399"))
    with pytest.raises(InvalidInputError, match="widen it"):
        plan(workspace=Workspace.parse("x=499.99:500.01,y=99.99:100.01"))


@pytest.mark.parametrize("text", ["x=1", "x=2:1", "w=1:2", "x=a:b", "x=nan:1", "x=1:1"])
def test_a_workspace_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(InvalidInputError, match="the lower first"):
        Workspace.parse(text)


def test_facts_are_those_of_the_path() -> None:
    some = plan(30)
    facts, path = some.facts(), np.concatenate([T_REF[None], some.path])
    steps, _ = pose_error(path[:-1], path[1:])
    assert facts["moves"] == len(path) - 1
    assert facts["travel_m"] == pytest.approx(steps.sum())
    assert facts["longest_step_mm"] == pytest.approx(1e3 * steps.max())
    assert facts["longest_step_mm"] <= 50 * (1 + 1e-9)
    assert facts["farthest_deg"] == pytest.approx(
        np.degrees(pose_error(T_REF, some.poses)[1].max())
    )
    turned = Plan.draw(
        Draws((Ring(30, 1.0),), np.array([0, 0, 0, 0.5, 0, 0]), 0), T_REF, pivot=PIVOT
    ).facts()  # turned about the part alone: the flange swings, the part stays in view
    assert turned["view_mm"] == pytest.approx(0, abs=1e-9)
    assert turned["farthest_mm"] > 100


def test_what_is_planned_is_said_and_drawn(tmp_path) -> None:
    some = plan(12)
    assert "12 images" in str(some)
    assert "no workspace is given" in str(some)
    assert "x 400 to 600 mm" in str(plan(12, workspace=Workspace.parse("x=400:600")))
    some.save_picture(tmp_path / "plan.png")
    assert (tmp_path / "plan.png").read_bytes()[:4] == b"\x89PNG"
