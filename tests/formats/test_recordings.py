"""Recordings: images get the poses of their times, though the clocks differ."""

import warnings

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from moving_camera import image_at, pose_at
from servoscope.data.clock import ImagePairs, estimate_clock_offset
from servoscope.data.trajectory import Trajectory
from servoscope.errors import DataSetError, InvalidInputError, ServoscopeWarning
from servoscope.formats import TumOptions, read_tum
from servoscope.poses import pose_error

TIMES = 10.0 + np.arange(150) / 30
LATE = 0.08


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """A TUM sequence whose images are stamped too late."""
    folder = tmp_path_factory.mktemp("recording")
    for i, time in enumerate(TIMES):
        cv2.imwrite(str(folder / f"{i:03d}.png"), image_at(time))
    pose_times = 9.0 + np.arange(0, 7.0, 0.008)
    T = pose_at(pose_times)
    q = Rotation.from_matrix(T[:, :3, :3]).as_quat()
    rows = [
        " ".join(map(repr, [float(t), *row[:3, 3].tolist(), *x.tolist()]))
        for t, row, x in zip(pose_times, T, q, strict=True)
    ]
    (folder / "groundtruth.txt").write_text("\n".join(rows))
    (folder / "rgb.txt").write_text(
        "\n".join(f"{time + LATE:.6f} {i:03d}.png" for i, time in enumerate(TIMES))
    )
    return folder


def read(folder, **options):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        data = read_tum(folder, TumOptions(reference_index=75, **options))
    return data, [str(w.message) for w in caught if "their poses by what" in str(w.message)]


def millimetres_off(data):
    return 1e3 * pose_error(data.T_world_cam, pose_at(TIMES))[0].max()


def test_an_offset_of_the_clocks_is_reported_with_its_uncertainty_and_not_applied(recording):
    data, (said,) = read(recording)
    estimate = data.source["clock_offset_estimate"]
    assert estimate["seconds"] == pytest.approx(LATE, abs=0.004)
    assert abs(estimate["seconds"] - LATE) < 4 * estimate["std"] < 0.02
    assert "images are 8" in said
    assert "ms behind their poses" in said
    assert "Apply it with --clock-offset estimate" in said
    assert data.source["clock_offset_s"] == 0.0
    assert millimetres_off(data) > 5


def test_the_estimate_is_applied_on_request(recording):
    data, (said,) = read(recording, clock_offset="estimate")
    assert "that was applied" in said
    assert data.source["clock_offset_s"] == pytest.approx(LATE, abs=0.004)
    assert millimetres_off(data) < 0.6


def test_a_number_is_applied_as_it_is_and_silences_the_report(recording):
    data, said = read(recording, clock_offset=LATE)
    assert not said
    assert millimetres_off(data) < 0.1
    data, said = read(recording, clock_offset=0)
    assert not said
    assert millimetres_off(data) > 5


@pytest.mark.parametrize("wrong", ["guess", float("nan")])
def test_a_wrong_offset_is_refused(wrong):
    with pytest.raises(InvalidInputError, match="clock_offset must be"):
        TumOptions(clock_offset=wrong)


def test_what_cannot_be_estimated_is_refused(pose_folder):
    pose_folder.write_tum()
    with pytest.raises(DataSetError, match="clock offset cannot be estimated, since too few"):
        read_tum(pose_folder.path, TumOptions(reference="02.png", clock_offset="estimate"))


def test_images_that_have_nothing_to_do_with_the_poses_are_no_ground_for_an_offset(recording):
    rng = np.random.default_rng(0)
    shifts = rng.normal(size=(149, 2))
    pairs = ImagePairs(TIMES[:-1], TIMES[1:], shifts)
    times = np.arange(9, 16, 0.008)
    found = estimate_clock_offset(pairs, Trajectory(times, pose_at(times)))
    assert not found.is_believable
    assert not found.is_certain


@pytest.mark.parametrize("late", [-0.31, 0.0, 0.012, 0.45])
@pytest.mark.parametrize("hertz", [10, 125])
def test_offsets_are_found_within_their_uncertainty_whatever_the_rate_of_the_poses(late, hertz):
    rng = np.random.default_rng(1)
    T = pose_at(TIMES)
    seen = -140 * np.diff(T[:, :2, 3], axis=0) + rng.normal(0, 0.15, (149, 2))
    times = np.arange(9, 16.5, 1 / hertz)
    pairs = ImagePairs(TIMES[:-1] + late, TIMES[1:] + late, seen)
    found = estimate_clock_offset(pairs, Trajectory(times, pose_at(times)))
    assert abs(found.seconds - late) < 4 * found.std + 0.002
    assert found.std < 0.01


def test_a_camera_at_rest_says_nothing_of_clocks():
    still = np.tile(np.eye(4), (100, 1, 1))
    rng = np.random.default_rng(0)
    pairs = ImagePairs(TIMES[:-1], TIMES[1:], 0.01 * rng.normal(size=(149, 2)))
    found = estimate_clock_offset(pairs, Trajectory(np.linspace(9, 16, 100), still))
    assert found is None or not found.is_believable


def test_images_at_rest_leave_the_offset_open():
    rng = np.random.default_rng(2)
    stops = np.cumsum(rng.normal(0, 0.01, (80, 3)), axis=0)
    rest = 2.0 * np.arange(80)
    times = (rest[:, None] + np.linspace(-0.8, 0.8, 17)).ravel()
    T = np.tile(np.eye(4), (len(times), 1, 1))
    T[:, :3, 3] = np.repeat(stops, 17, axis=0)
    shifts = -140 * np.diff(stops[:, :2], axis=0) + rng.normal(0, 0.1, (79, 2))
    found = estimate_clock_offset(ImagePairs(rest[:-1], rest[1:], shifts), Trajectory(times, T))
    assert found.std > 0.5
    assert abs(found.seconds) < 0.2
    assert not found.is_believable
    assert not found.is_certain


def test_the_most_images_are_chosen_evenly_and_the_rest_is_counted(recording):
    with pytest.warns(ServoscopeWarning, match="130 between others"):
        data = read_tum(recording, TumOptions(reference_index=75, max_images=20, clock_offset=0))
    assert len(data) == 20
    assert "075.png" in data.names
    numbers = np.array([int(name[:3]) for name in data.names])
    assert np.diff(numbers).min() >= 3
    assert np.diff(numbers).max() <= 13
