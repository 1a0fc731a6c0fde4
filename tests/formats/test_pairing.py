import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from servoscope.formats import Trajectory, pair_in_time
from servoscope.poses import rigid_transform


@pytest.fixture
def trajectory(rng):
    times = np.sort(rng.uniform(0, 10, 50))
    rotations = Rotation.from_rotvec(rng.uniform(-1, 1, (50, 3))).as_matrix()
    return Trajectory(times, rigid_transform(rotations, rng.uniform(-1, 1, (50, 3))))


def test_interpolation_agrees_with_slerp_and_linear_interpolation(trajectory, rng):
    times = rng.uniform(trajectory.times[0], trajectory.times[-1], 200)
    T, _ = pair_in_time(trajectory, times)
    slerp = Slerp(trajectory.times, Rotation.from_matrix(trajectory.T_world_cam[:, :3, :3]))
    np.testing.assert_allclose(T[:, :3, :3], slerp(times).as_matrix(), atol=1e-12)
    for k in range(3):
        expected = np.interp(times, trajectory.times, trajectory.T_world_cam[:, k, 3])
        np.testing.assert_allclose(T[:, k, 3], expected, atol=1e-12)


def test_a_pose_of_the_very_time_is_taken_as_it_stands(trajectory):
    T, gaps = pair_in_time(trajectory, trajectory.times)
    np.testing.assert_allclose(T, trajectory.T_world_cam, atol=1e-12)
    np.testing.assert_array_equal(gaps, 0)


def test_outside_the_trajectory_the_end_poses_hold(trajectory):
    first, last = trajectory.times[[0, -1]]
    T, gaps = pair_in_time(trajectory, [first - 2, last + 3])
    np.testing.assert_allclose(T, trajectory.T_world_cam[[0, -1]], atol=1e-12)
    np.testing.assert_allclose(gaps, [2, 3])


@pytest.mark.parametrize("pairing", ["interpolate", "nearest"])
def test_the_order_of_the_trajectory_does_not_matter(trajectory, rng, pairing):
    order = rng.permutation(len(trajectory.times))
    shuffled = Trajectory(trajectory.times[order], trajectory.T_world_cam[order])
    times = rng.uniform(-1, 11, 100)
    for a, b in zip(
        pair_in_time(trajectory, times, pairing),
        pair_in_time(shuffled, times, pairing),
        strict=True,
    ):
        np.testing.assert_array_equal(a, b)


@given(
    known=st.lists(st.floats(0, 100), min_size=1, max_size=20),
    wanted=st.lists(st.floats(-10, 110), min_size=1, max_size=20),
)
def test_nearest_pairing_is_the_least_of_all_gaps(known, wanted):
    known, wanted = np.array(known), np.array(wanted)
    poses = rigid_transform(np.eye(3), known[:, None] * [1, 0, 0])
    T, gaps = pair_in_time(Trajectory(known, poses), wanted, "nearest")
    least = np.abs(known[:, None] - wanted).min(axis=0)
    np.testing.assert_array_equal(gaps, least)
    np.testing.assert_array_equal(np.abs(T[:, 0, 3] - wanted), least)


@given(known=st.lists(st.sampled_from([0.0, 1.0, 2.0]), min_size=1, max_size=8))
def test_repeated_times_interpolate_to_finite_poses(known):
    known = np.array(known)
    poses = rigid_transform(np.eye(3), known[:, None] * [1, 0, 0])
    wanted = np.array([0.0, 0.5, 1.0, 1.5, 2.0])
    T, _ = pair_in_time(Trajectory(known, poses), wanted)
    np.testing.assert_allclose(T[:, 0, 3], wanted.clip(known.min(), known.max()))
