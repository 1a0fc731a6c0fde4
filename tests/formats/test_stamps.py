"""Stamps that cannot be seconds or belong to several poses are refused; poses are interpolated."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from servoscope.errors import DataSetError, ServoscopeWarning
from servoscope.formats import Trajectory, TumOptions, pair_in_time, read_tum
from servoscope.formats.stamps import check_seconds, resolution
from servoscope.poses import rigid_transform

NAMED = TumOptions(reference="02.png")
SINCE_1970 = 1_403_636_579.0


def refusal(source, options=NAMED):
    with pytest.raises(DataSetError) as caught:
        read_tum(source.path, options)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def rewrite(path, edit):
    path.write_text("\n".join(edit(path.read_text().splitlines())) + "\n")


@pytest.mark.parametrize("place", [1, -1])
def test_two_poses_at_one_stamp_are_refused_or_left_out(pose_folder, place):
    pose_folder.write_tum()
    rewrite(
        pose_folder.path / "groundtruth.txt",
        lambda lines: [*lines[:place], "100.2 9 0 0 0 0 0 1", *lines[place:]],
    )
    message = refusal(pose_folder)
    assert "1 stamps stand for different poses, up to 8980 mm" in message
    assert "the first is 100.200000" in message
    options = TumOptions(reference="01.png", skip_bad=True, max_gap_s=0.15)
    with pytest.warns(ServoscopeWarning, match=r"1 stamps of several poses \(100.200000\)"):
        data = read_tum(pose_folder.path, options)
    np.testing.assert_allclose(data.T_world_cam[2, :3, 3], [0.02, 0, 0], atol=1e-6)


def test_a_pose_that_is_written_twice_is_one(pose_folder):
    pose_folder.write_tum()
    rewrite(pose_folder.path / "groundtruth.txt", lambda lines: [*lines, lines[3], lines[3]])
    data = read_tum(pose_folder.path, NAMED)
    np.testing.assert_allclose(data.T_world_cam, pose_folder.T_world_cam, atol=1e-9)


@pytest.mark.parametrize(
    ("factor", "start", "unit"),
    [
        (1e9, SINCE_1970, "ns"),
        (1e6, SINCE_1970, "us"),
        (1e3, SINCE_1970, "ms"),
        (1e9, 0, "ns"),
        (1e6, 0, "us"),
    ],
)
@pytest.mark.parametrize("both", [True, False])
def test_stamps_that_are_not_seconds_are_refused(pose_folder, factor, start, unit, both):
    seconds = start + np.arange(6) / 10
    images = seconds * (factor if both else 1)
    pose_folder.write_tum(pose_times=seconds * factor, image_times=images)
    message = refusal(pose_folder)
    assert f"stamps must be seconds, but those like {np.median(seconds) * factor:.0f}" in message
    assert f"are in {unit}; divide them" in message


@pytest.mark.parametrize("pause", [1200, 3600, 14_400])
def test_a_time_lapse_is_taken_as_seconds_with_a_warning(pause):
    with pytest.warns(ServoscopeWarning, match=f"{pause} apart, and taken as seconds; if they are"):
        check_seconds(SINCE_1970 + pause * np.arange(5), "rgb.txt")


@pytest.mark.parametrize("stamp", ["0e400", "0e99999999999999999999", "0e-99999999999999999999"])
@pytest.mark.parametrize("name", ["rgb.txt", "groundtruth.txt"])
def test_a_stamp_with_an_exponent_beyond_all_clocks_is_refused(pose_folder, stamp, name):
    pose_folder.write_tum()
    rewrite(
        pose_folder.path / name,
        lambda lines: [*lines[:-1], " ".join([stamp, *lines[-1].split()[1:]])],
    )
    message = refusal(pose_folder)
    assert re.search(rf"{name}, line \d+: stamps must be seconds without large expo", message)


@pytest.mark.parametrize("pause", [1e-4, 1 / 30, 1.0, 60.0])
def test_seconds_of_any_clock_and_pace_are_taken(pause):
    for start in (0.0, -5.0, SINCE_1970):
        check_seconds(start + pause * np.arange(5), "rgb.txt")


@pytest.mark.parametrize(
    ("texts", "step"),
    [(["1.5", "1.25"], 0.01), (["7"], 1), (["1.3e9"], 1e8), (["1e-3"], 1e-3), (["2.000"], 1e-3)],
)
def test_the_step_of_stamps_is_that_of_their_finest(texts, step):
    assert resolution(texts) == pytest.approx(step)


def fast(pose_folder, pose_format, image_format):
    """1 m/s and 30 images a second, whose stamps are written with fewer decimals."""
    times = SINCE_1970 + np.arange(60) / 30
    numbers = [f"{t - SINCE_1970} 0 0 0 0 0 1" for t in times]
    images = np.random.default_rng(1).integers(0, 256, (60, 12, 16), dtype=np.uint8)
    for i, image in enumerate(images):
        pose_folder.write_image(f"{i:02d}.png", image)
    pairs = zip(times, numbers, strict=True)
    pose_folder.write_lines("groundtruth.txt", [f"{pose_format % t} {n}" for t, n in pairs])
    lines = [f"{image_format % t} {i:02d}.png" for i, t in enumerate(times)]
    pose_folder.write_lines("rgb.txt", lines)


def test_images_that_share_a_rounded_stamp_are_warned_of_with_what_it_costs(pose_folder):
    fast(pose_folder, "%.6f", "%.1f")
    with pytest.warns(ServoscopeWarning) as caught:
        read_tum(pose_folder.path, TumOptions(reference="02.png", max_gap_s=0.05))
    said = " ".join(str(warning.message) for warning in caught)
    assert re.search("5[0-9] of 60 images share their stamp with another", said)
    assert "steps of 0.1 s: if they were rounded, poses are up to 50 mm" in said


@pytest.mark.parametrize("stamp", ["%.1f", "%g", "%.0f"])
def test_poses_whose_stamps_were_rounded_together_are_refused(pose_folder, stamp):
    fast(pose_folder, stamp, "%.6f")
    assert "stamps stand for different poses" in refusal(pose_folder)


def test_full_decimals_pass_silently(pose_folder):
    fast(pose_folder, "%.4f", "%.6f")
    assert len(read_tum(pose_folder.path, NAMED)) == 60


def test_a_pose_that_jumps_faster_than_a_camera_can_be_moved_is_warned_of(pose_folder):
    fast(pose_folder, "%.4f", "%.6f")
    rewrite(
        pose_folder.path / "groundtruth.txt",
        lambda lines: [
            " ".join([line.split()[0], "0 9 0 0 0 0 1"]) if 20 <= i < 30 else line
            for i, line in enumerate(lines)
        ],
    )
    with pytest.warns(ServoscopeWarning) as caught:
        read_tum(pose_folder.path, NAMED)
    said = " ".join(str(warning.message) for warning in caught)
    assert "The pose jumps 2 times, by up to 90" in said
    assert "with a pose that stays while the image changes" in said


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
