import json
import re
import time
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from planar import PIVOT, RANGES, planar_data_set, planar_images
from real_sets import SEQUENCES, real_sequence
from servoscope.acquisition import AcquisitionConfig, acquire
from servoscope.data.checks import check_data, check_poses, fault_words, image_faults
from servoscope.data.images import PoseImageSet
from servoscope.poses import (
    displacements_from_poses,
    inverse_transform,
    poses_from_displacements,
    rigid_transform,
)


@pytest.fixture
def images(rng):
    """Smooth pictures with the noise of a sensor."""
    y, x = np.indices((40, 48))
    shifts = rng.uniform(0, 6, (30, 1, 1))
    pictures = 120 + 60 * np.sin(x / 7 + shifts) * np.cos(y / 5)
    return np.clip(pictures + rng.normal(0, 2, pictures.shape), 0, 255).astype(np.uint8)


def poses(*mm, degrees=None, axis=2):
    degrees = np.zeros(len(mm)) if degrees is None else np.asarray(degrees, dtype=float)
    R = Rotation.from_rotvec(np.outer(np.radians(degrees), np.eye(3)[axis])).as_matrix()
    return rigid_transform(R, np.outer(mm, [1e-3, 0, 0]))


def faults_of(images, T=None):
    T = poses(*range(len(images))) if T is None else T
    return {
        reason: np.flatnonzero(bad).tolist()
        for reason, bad in image_faults(images, T).items()
        if bad.any()
    }


def texts_of(data, faults=None):
    return [finding.text for finding in check_data(data, faults)]


def pose_texts(data):
    return [finding.text for finding in check_poses(data)]


def data_set(T, images=None, **changes):
    if images is None:
        images = np.random.default_rng(0).integers(0, 256, (len(T), 12, 16), dtype=np.uint8)
    return PoseImageSet(images, T, T[0], images[0], **{"pivot": 0.5} | changes)


def test_sound_images_have_no_fault(images):
    assert faults_of(images) == {}
    assert faults_of(images // 8 + 20) == {}  # of low contrast, but all of them


def test_images_that_show_nothing_are_found_with_the_noise_of_a_sensor(images, rng):
    noise = rng.normal(0, 2, images[0].shape)
    images[3] = np.clip(1 + noise, 0, 255)
    images[7] = 0
    images[5] = np.clip(300 + noise, 0, 255)
    images[11] = np.clip(128 + noise, 0, 255)
    images[12] = 77
    assert faults_of(images) == {"black": [3, 7], "saturated": [5], "flat": [11, 12]}


def test_a_frozen_camera_is_found_and_a_still_one_is_not(images):
    images[[4, 5, 20]] = images[4]
    assert faults_of(images) == {"repeated": [5, 20]}
    T = poses(*range(30))
    T[[5, 20]] = T[4]
    assert faults_of(images, T) == {}


def test_faults_are_found_in_every_block(images, monkeypatch):
    monkeypatch.setattr("servoscope.data.checks._IMAGES_PER_BLOCK", 7)
    images[[6, 7, 29]] = 0
    assert faults_of(images) == {"black": [6, 7, 29]}


def test_many_names_are_cut_short():
    bad = np.arange(10) % 2 == 0
    words = fault_words({"black": bad, "flat": ~bad & False}, [f"{i}.png" for i in range(10)])
    assert words == "5 black (0.png, 2.png, ...)"


@pytest.mark.parametrize(("largest", "told"), [(200, False), (1900, False), (2100, True)])
def test_cameras_farther_from_the_reference_than_the_part_are_told(largest, told):
    texts = pose_texts(data_set(poses(*np.linspace(0, 0.4, 20) * 100, largest)))
    assert bool(texts) == told
    assert all(f"up to {largest} mm" in text and "check the units" in text for text in texts)


def test_a_set_of_one_pose_is_told():
    assert pose_texts(data_set(poses(0, 0, 0))) == [
        "All images have one pose: nothing can be learned from them; take them at others."
    ]


def test_half_the_cameras_beyond_twice_the_part_are_told():
    assert pose_texts(data_set(poses(0, 0, 1100, 1100, 1100)))


@pytest.mark.parametrize(
    ("degrees", "axis", "told"),
    [
        ([0, 30, -30], 2, None),
        ([0, 90, 170], 2, None),
        ([0, 170, 190], 2, "rz wrap at 180 deg"),
        ([0, 170, 190], 0, "rx wrap at 180 deg"),
        ([0, 60, 85], 1, "ry come to 85.0 deg"),
        ([0, 60, 70], 1, None),
    ],
)
def test_angles_that_cannot_be_learned_are_told(degrees, axis, told):
    texts = pose_texts(data_set(poses(0, 0, 0, degrees=degrees, axis=axis)))
    assert [told in text for text in texts] == [True] * (told is not None)


def test_a_data_set_tells_of_its_images_and_poses(images):
    images[20] = 0
    texts = texts_of(data_set(poses(*range(29), 9000), images))
    assert texts[0].startswith("Of 30 images some are of no use: 1 black (000020)")
    assert "check the units" in texts[1]


@pytest.mark.parametrize(
    ("source", "options"),
    [
        ({"format": "tum"}, ["import with --skip-bad", "(--units mm?)", "--max-mm", "--max-deg"]),
        ({"rings": 3}, []),
        ({}, []),
    ],
)
def test_options_of_import_are_named_only_where_there_was_one(images, source, options):
    images[20] = 0
    T = poses(*range(29), 9000, degrees=[0] * 28 + [170, 190])
    said = " ".join(texts_of(data_set(T, images, source=source)))
    assert re.findall(r"import with --skip-bad|\(--units mm\?\)|--max-\w+", said) == options
    assert "--" in said or "take them anew" in said


@pytest.mark.parametrize(("pivot", "named"), [(0.5, "part is taken to be 500 mm"), (0.0, None)])
def test_a_pivot_is_named_if_there_is_one(pivot, named):
    (text,) = pose_texts(data_set(poses(0, 0, 5000), pivot=pivot))
    assert ("before it" in text) == (named is not None)
    assert named is None or named in text


def test_faults_that_are_known_are_not_looked_for_again(images, monkeypatch):
    data, faults = data_set(poses(*range(30)), images), {"flat": np.arange(30) == 4}
    monkeypatch.setattr("servoscope.data.checks.image_faults", pytest.fail)
    (text,) = texts_of(data, faults)
    assert "1 flat (000004)" in text


# Faults planted in sound sets


@pytest.fixture(scope="module")
def plane():
    """Images at random poses."""
    return planar_data_set(80, 64)


@pytest.fixture(scope="module")
def video():
    """Images of a camera that wanders, 25 a second, and the poses at any other time."""
    knots = 0.6 * np.random.default_rng(3).uniform(-1, 1, (20, 6)) * RANGES
    spline = CubicSpline(np.linspace(-1, 7, 20), knots)
    times = np.arange(150) / 25
    images = planar_images(np.vstack([spline(times), np.zeros(6)]), 64, 0)
    data = PoseImageSet(
        images[:-1], poses_from_displacements(np.eye(4), spline(times), PIVOT), np.eye(4),
        images[-1], pivot=PIVOT, times=times, split="blocks",
    )  # fmt: skip
    return data, lambda at: poses_from_displacements(np.eye(4), spline(at), PIVOT)


def names(data):
    return [finding.name for finding in check_data(data)]


def only(data, name):
    """The finding, which must be the only one."""
    (finding,) = check_data(data)
    assert finding.name == name
    assert finding.text.endswith(".")
    assert "\n" not in finding.text
    json.dumps(finding.numbers)
    return finding


def noisy(images, sigma=2.0, seed=0):
    noise = np.random.default_rng(seed).normal(0, sigma, images.shape)
    return np.clip(images + noise, 0, 255).round().astype(np.uint8)


@pytest.mark.parametrize("sigma", [0.0, 5.0])
def test_a_sound_set_and_a_sound_sequence_raise_nothing(plane, video, sigma):
    for data in (plane, video[0], replace(video[0], times=None)):
        assert names(replace(data, images=noisy(data.images, sigma))) == []


@pytest.mark.parametrize("robot", ["free", "arm"])
def test_a_set_of_the_simulated_cell_raises_nothing(tmp_path, robot):
    config = AcquisitionConfig(n_images=48, image_size=32, part="textured_plane", robot=robot)
    assert names(acquire(tmp_path, config, n_jobs=1)) == []


@pytest.mark.parametrize("name", SEQUENCES)
def test_real_sequences_raise_nothing_but_the_copies_that_one_has(name):
    found = check_data(real_sequence(name))
    assert [finding.name for finding in found] == ["repeated"] * (name == "kitchen")


def test_one_black_frame_is_named(plane):
    images = plane.images.copy()
    images[20] = 0
    finding = only(replace(plane, images=images), "black")
    assert finding.images == ("000020",)
    assert finding.numbers == {"black": 1}


def test_dofs_that_only_move_together_are_named_with_the_number_of_motions():
    q = np.random.default_rng(0).uniform(-1, 1, (120, 2))
    gantry = q @ np.random.default_rng(1).uniform(0.3, 1, (2, 6)) * RANGES
    gantry += 2e-3 * RANGES * np.random.default_rng(2).normal(size=gantry.shape)
    gantry[:4] = RANGES * np.random.default_rng(3).uniform(-1, 1, (4, 6))  # driven by hand
    images = planar_images(gantry, 48, 0)
    poses = poses_from_displacements(np.eye(4), gantry, PIVOT)
    data = PoseImageSet(images, poses, np.eye(4), images[0], pivot=PIVOT)
    (finding,) = [f for f in check_data(data) if f.name == "dependent_dofs"]
    assert list(finding.numbers["r2"]) == ["tx", "ty", "tz", "rx", "ry", "rz"]
    assert finding.numbers["n_independent"] == 2
    assert "6 degrees of freedom move, but by 2 independent motions" in finding.text


def test_one_tied_pair_among_free_dofs_is_named_and_looser_ties_are_not():
    delta_p = planar_data_set(100, 8).delta_p()
    for noise, tied in ((0.03, ["tx", "ry"]), (0.5, [])):
        delta_p[:, 4] = delta_p[:, 0] / RANGES[0] * RANGES[4]
        delta_p[:, 4] += noise * RANGES[4] * np.random.default_rng(3).normal(size=100)
        data = data_set(poses_from_displacements(np.eye(4), delta_p, 0.5))
        found = [list(f.numbers["r2"]) for f in check_data(data) if f.name == "dependent_dofs"]
        assert found == [tied] * bool(tied)


def shots(plane, n_shots, jitter=0.0):
    """Several shots of each pose, with noise, in any order."""
    which = np.random.default_rng(4).permutation(np.repeat(np.arange(len(plane)), n_shots))
    delta_p = plane.delta_p()[which]
    delta_p += jitter * RANGES * np.random.default_rng(5).uniform(-1, 1, delta_p.shape)
    poses = poses_from_displacements(np.eye(4), delta_p, PIVOT)
    return replace(plane, images=noisy(plane.images[which]), T_world_cam=poses, names=()), which


@pytest.mark.parametrize("jitter", [0.0, 5e-4])
def test_repeated_shots_are_counted(plane, jitter):
    data, _ = shots(plane, 3, jitter)
    assert only(data, "repeated_shots").numbers == {"n_repeats": 160, "n_poses": 80}


def test_of_very_many_images_it_is_said_how_many_were_looked_at(plane, monkeypatch):
    monkeypatch.setattr("servoscope.data.checks._MOST_VIEWED", 120)
    text = only(shots(plane, 3)[0], "repeated_shots").text
    assert " of 120 images that were looked at, of 240, repeat the pose" in text


def test_few_repeated_shots_are_counted_too(plane):
    data, _ = shots(plane, 1)
    again = replace(data[:4], images=noisy(data.images[:4], seed=9))
    assert only(data + again, "repeated_shots").numbers == {"n_repeats": 4, "n_poses": 80}


def test_a_part_that_was_moved_between_equal_poses_is_noticed(plane):
    shift = poses_from_displacements(np.eye(4), [2e-3, 1e-3, 0, 0, 0, 0.02], PIVOT)
    moved = planar_images(
        displacements_from_poses(np.eye(4), shift @ plane.T_world_cam, PIVOT), 64, 0
    )
    data = plane + replace(plane, images=noisy(moved))
    (finding,) = [f for f in check_data(data) if f.name == "unlike_images"]
    assert "was the part moved" in finding.text
    assert finding.numbers["n_pairs"] == 80
    assert finding.numbers["n_unlike"] > 70


@pytest.mark.parametrize("light", [lambda x: 0.7 * x + 20, lambda x: x])
def test_noise_and_light_between_equal_poses_are_no_motion(plane, light):
    other = noisy(light(plane.images.astype(float)), 6.0)
    assert names(plane + replace(plane, images=other)) == ["repeated_shots"]


def test_the_repeatability_of_a_robot_is_no_motion_of_the_part(plane):
    jitter = 2.8e-3 * RANGES * np.random.default_rng(7).uniform(-1, 1, (80, 6))
    again = planar_images(plane.delta_p() + jitter, 64, 0)
    assert names(plane + replace(plane, images=again)) == ["repeated_shots"]


@pytest.mark.parametrize("rows", [-3, -1, 1, 2])
def test_images_that_are_rows_behind_random_poses_are_noticed(plane, rows):
    late = replace(plane, images=noisy(np.roll(plane.images, rows, axis=0)))
    finding = only(late, "late_images")
    assert finding.numbers["lag"] == rows
    assert finding.numbers["unit"] == "rows"
    assert f"{abs(rows)} row" in finding.text
    assert ("behind" in finding.text) == (rows > 0)


@pytest.mark.parametrize("rows", [-2, 1, 3])
def test_images_that_are_rows_behind_a_sequence_are_noticed(video, rows):
    data = replace(video[0], images=noisy(np.roll(video[0].images, rows, axis=0)), times=None)
    assert only(data, "late_images").numbers["lag"] == rows


@pytest.mark.parametrize("seconds", [-0.25, 0.05, 0.1, 0.3])
def test_images_that_are_some_time_behind_their_poses_are_noticed(video, seconds):
    data, pose_at = video
    late = replace(data, T_world_cam=pose_at(data.times + seconds), images=noisy(data.images))
    finding = only(late, "late_images")
    assert finding.numbers["lag"] == pytest.approx(seconds, abs=0.015)
    assert " ms " in finding.text


@pytest.mark.parametrize("name", SEQUENCES)
@pytest.mark.parametrize("rows", [-1, 2])
def test_real_images_behind_their_poses_are_noticed(name, rows):
    data = real_sequence(name)
    late = replace(data, images=np.roll(data.images, rows, axis=0))
    (finding,) = [f for f in check_data(late) if f.name == "late_images"]
    assert finding.numbers["lag"] == pytest.approx(rows / 30, abs=0.015)


def inverted(data):
    T = inverse_transform(data.T_world_cam)
    return replace(
        data, T_world_cam=T, T_world_ref=inverse_transform(data.T_world_ref), pivot_ranges=None
    )


def test_inverted_poses_are_noticed(plane, video):
    base = poses_from_displacements(np.eye(4), [0.4, -0.3, 0.8, 2.8, 0.3, 0.7], 0.0)
    for data in (plane, video[0]):
        placed = replace(data, T_world_cam=base @ data.T_world_cam, T_world_ref=base)
        assert "inverted_poses" in names(inverted(placed))
        assert "inverted_poses" not in names(placed)


@pytest.mark.parametrize(
    ("given", "advised"),
    [("camera-to-world", "world-to-camera"), ("world-to-camera", "camera-to-world")],
)
def test_inverted_poses_are_imported_the_other_way(plane, given, advised):
    source = {"format": "folder", "options": {"direction": given}}
    found = check_data(replace(inverted(plane), source=source))
    (text,) = (finding.text for finding in found if finding.name == "inverted_poses")
    assert text.endswith(f"or import with --direction {advised}.")


@pytest.mark.parametrize("name", SEQUENCES)
def test_inverted_poses_of_real_images_are_noticed(name):
    assert "inverted_poses" in names(inverted(real_sequence(name)))


@pytest.mark.parametrize("seed", range(8))
def test_poses_of_a_flange_do_not_look_inverted_however_the_camera_is_mounted(plane, seed):
    turn = Rotation.random(random_state=seed).as_matrix()
    mount = rigid_transform(turn, np.array([0.05, -0.03, 0.1]))
    data = replace(
        plane, T_world_cam=plane.T_world_cam @ mount, T_world_ref=mount, pivot_ranges=None
    )
    assert "inverted_poses" not in names(data)


@settings(max_examples=60, deadline=None)
@given(
    n=st.sampled_from([1, 2, 3, 12, 45, 60]),
    side=st.integers(1, 20),
    kind=st.sampled_from(["random", "walk", "places", "still"]),
    clock=st.sampled_from([None, "regular", "coarse", "stopped"]),
    seed=st.integers(0, 1000),
)
@pytest.mark.filterwarnings("error")
def test_any_set_is_checked_and_described(n, side, kind, clock, seed):
    rng = np.random.default_rng(seed)
    p = rng.uniform(-1, 1, (n, 6)) * rng.integers(0, 2, 6) * 10.0 ** rng.integers(-6, 1, 6)
    if kind == "walk":
        p = np.cumsum(p, axis=0) / 10
    p = {"places": p[rng.integers(0, max(n // 4, 1), n)], "still": 0 * p}.get(kind, p)
    images = rng.integers(0, 256, (n, side, 9), dtype=np.uint8)
    images[rng.integers(0, n, 2)] = 0
    times = {"regular": np.arange(n) / 30, "coarse": np.arange(n) // 4, "stopped": np.zeros(n)}
    data = data_set(
        poses_from_displacements(np.eye(4), p * RANGES, 0.5), images,
        times=None if clock is None else times[clock].astype(float),
        split=("random", "blocks")[seed % 2],
    )  # fmt: skip
    for finding in check_data(data):
        assert "\n" not in finding.text
        json.dumps(finding.numbers)
    assert repr(data)
    assert data._repr_html_()


def test_a_thousand_images_are_checked_in_seconds():
    data = planar_data_set(1000, 64)
    began = time.process_time()
    assert check_data(data) == []
    assert time.process_time() - began < 6  # 1.4 s of 1000 images of 256 x 256


def test_faults_are_found_block_by_block(monkeypatch) -> None:
    """What is kept of a block is small: the most memory does not grow with the images."""
    rng = np.random.default_rng(0)
    images = rng.integers(0, 256, (3000, 64, 64), dtype=np.uint8)
    poses = np.tile(np.eye(4), (len(images), 1, 1))
    monkeypatch.setattr("servoscope.storage.stacks.BLOCK_BYTES", 2**18)
    tracemalloc.start()
    image_faults(images, poses)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 0.5 * images.nbytes
