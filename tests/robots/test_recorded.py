"""A robot that lives in a recording goes to the nearest frame, and the loop says how near it is."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from planar import PIVOT, RANGES, planar_data_set
from planar_cell import Oracle
from servoscope.errors import InvalidInputError
from servoscope.poses import displacements_from_poses, poses_from_displacements, rigid_transform
from servoscope.positioning import Estimate, LoopSettings, Positioner
from servoscope.robots.recorded import RecordedRobot

DATA = planar_data_set(n_images=60, size=48, seed=3)


class Reader:
    """Reads the displacement of the frame that a robot is at, off by a share of it."""

    image_shape, reference_image = DATA.image_shape, DATA.reference_image
    pivot, reach = PIVOT, RANGES

    def __init__(self, robot: RecordedRobot, share: float = 0.0, std: float = 0.01) -> None:
        self.robot, self.share, self.std = robot, share, std * RANGES

    def estimate(self, image, previous) -> Estimate:
        delta_p = displacements_from_poses(DATA.T_world_ref, self.robot.pose[None], PIVOT)[0]
        believed = poses_from_displacements(np.eye(4), (1 + self.share) * delta_p, PIVOT)
        return Estimate(believed, self.std, np.nan, "reader")


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([1.0, 10.0, 100.0]))
def test_it_goes_to_the_frame_that_is_nearest_in_mm_and_degrees(seed, mm_per_deg) -> None:
    T = poses_from_displacements(
        np.eye(4), np.random.default_rng(seed).uniform(-1, 1, 6) * RANGES, PIVOT
    )
    robot = RecordedRobot(DATA, start=5, mm_per_deg=mm_per_deg)
    robot.move_to(T)
    frames = [*DATA.T_world_cam, DATA.T_world_ref]
    away = [
        np.hypot(
            1e3 * np.linalg.norm(frame[:3, 3] - T[:3, 3]),
            mm_per_deg
            * np.degrees(
                (
                    Rotation.from_matrix(T[:3, :3]).inv() * Rotation.from_matrix(frame[:3, :3])
                ).magnitude()
            ),
        )
        for frame in frames
    ]
    assert robot.frame == np.argmin(away)
    images = [*DATA.images, DATA.reference_image]
    np.testing.assert_array_equal(robot.read(), images[robot.frame])


def test_it_reports_what_it_executed_and_not_what_it_was_told() -> None:
    robot = RecordedRobot(DATA, start=5)
    before = robot.pose
    executed = robot.move(rigid_transform(np.eye(3), [0.01, -0.02, 0.005]))
    np.testing.assert_allclose(before @ executed, robot.pose, atol=1e-12)
    assert any(np.array_equal(robot.pose, T) for T in [*DATA.T_world_cam, DATA.T_world_ref])
    robot.read()[:] = 0
    assert robot.read().any()
    robot.pose[:] = 0
    assert robot.pose[3, 3] == 1
    assert robot.stop() is None


def test_it_can_do_without_the_reference() -> None:
    twin = replace(
        DATA,
        images=np.concatenate([DATA.images, DATA.reference_image[None]]),
        T_world_cam=np.concatenate([DATA.T_world_cam, DATA.T_world_ref[None]]),
        names=(),
    )
    robot = RecordedRobot(twin, with_reference=False)
    robot.move_to(DATA.T_world_ref)
    assert robot.frame < len(DATA)
    assert robot.is_within_spacing()
    assert robot.from_reference().mm > 1


@pytest.mark.parametrize("start", [0, 7, 31])
def test_the_loop_ends_at_the_reference_where_that_was_recorded(start) -> None:
    robot = RecordedRobot(DATA, start)
    loop = LoopSettings().for_poses_apart(*robot.spacing())
    result = Positioner(Reader(robot, share=-0.3), loop).run(robot, robot)
    assert (result.status, robot.frame) == ("converged", len(DATA)), result.message


@pytest.mark.parametrize("start", [0, 7, 31])
def test_the_loop_is_limited_and_never_converged_where_it_was_not(start) -> None:
    robot = RecordedRobot(DATA, start, with_reference=False)
    loop = LoopSettings().for_poses_apart(*robot.spacing())
    result = Positioner(Reader(robot), loop).run(robot, robot)
    assert result.status == "limited", result.message
    assert "As near as the robot allows" in result.message
    assert robot.is_within_spacing()
    assert result.moves <= 4
    with_tolerance = LoopSettings(tolerance_mm=0.1).for_poses_apart(*robot.spacing())
    assert Positioner(Reader(robot), with_tolerance).run(robot, robot).status == "limited"


def test_an_ordinary_loop_refuses_a_robot_that_does_not_go_where_it_is_sent() -> None:
    robot = RecordedRobot(DATA, 7, with_reference=False)
    assert Positioner(Reader(robot)).run(robot, robot).status == "robot_fault"


def test_a_robot_that_scatters_by_millimetres_is_limited_and_not_converged() -> None:
    from planar_cell import Cell

    rng = np.random.default_rng(0)

    class Scattering(Cell):
        def move(self, displacement):
            off = poses_from_displacements(np.eye(4), rng.normal(size=6) * 0.05 * RANGES, PIVOT)
            return super().move(displacement @ off)

    cell = Scattering(0.3 * RANGES)
    loop = LoopSettings(max_moves=20, execution_mm=40, execution_deg=5, largest_innovation=None)
    result = Positioner(Oracle(cell, std=1e-4), loop).run(cell, cell)
    assert result.status == "limited", result.message


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"start": 61}, "frame from 0 to 60"),
        ({"start": -1}, "frame from 0 to 60"),
        ({"start": 60, "with_reference": False}, "frame from 0 to 59"),
        ({"mm_per_deg": 0.0}, "mm_per_deg"),
        ({"mm_per_deg": np.nan}, "mm_per_deg"),
    ],
)
def test_bad_arguments_are_refused_in_a_line(arguments, said) -> None:
    with pytest.raises(InvalidInputError, match=said):
        RecordedRobot(DATA, **arguments)


def test_it_is_sent_to_rigid_transforms_only() -> None:
    robot = RecordedRobot(DATA)
    for bad in (np.eye(3), np.full((4, 4), np.nan), 2 * np.eye(4), "there"):
        with pytest.raises(InvalidInputError):
            robot.move_to(bad)
        with pytest.raises(InvalidInputError, match="displacement must"):
            robot.move(bad)
    at_reference = replace(DATA, T_world_cam=np.tile(DATA.T_world_ref, (len(DATA), 1, 1)))
    with pytest.raises(InvalidInputError, match="at the reference"):
        RecordedRobot(at_reference)
