import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from servoscope.data.checks import (
    data_set_warnings,
    fault_words,
    image_faults,
    pose_warnings,
)
from servoscope.data.images import PoseImageSet
from servoscope.poses import rigid_transform


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
    texts = pose_warnings(data_set(poses(*np.linspace(0, 0.4, 20) * 100, largest)))
    assert bool(texts) == told
    assert all(f"up to {largest} mm" in text and "check the units" in text for text in texts)


def test_a_set_of_one_pose_is_told():
    assert pose_warnings(data_set(poses(0, 0, 0))) == [
        "All images have one pose: nothing can be learned from them."
    ]


def test_half_the_cameras_beyond_twice_the_part_are_told():
    assert pose_warnings(data_set(poses(0, 0, 1100, 1100, 1100)))


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
    texts = pose_warnings(data_set(poses(0, 0, 0, degrees=degrees, axis=axis)))
    assert [told in text for text in texts] == [True] * (told is not None)


def test_a_data_set_tells_of_its_images_and_poses(images):
    images[20] = 0
    texts = data_set_warnings(data_set(poses(*range(29), 9000), images))
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
    said = " ".join(data_set_warnings(data_set(T, images, source=source)))
    assert re.findall(r"import with --skip-bad|\(--units mm\?\)|--max-\w+", said) == options
    assert "--" in said or "take them anew" in said


@pytest.mark.parametrize(("pivot", "named"), [(0.5, "part is taken to be 500 mm"), (0.0, None)])
def test_a_pivot_is_named_if_there_is_one(pivot, named):
    (text,) = pose_warnings(data_set(poses(0, 0, 5000), pivot=pivot))
    assert ("before it" in text) == (named is not None)
    assert named is None or named in text


def test_faults_that_are_known_are_not_looked_for_again(images, monkeypatch):
    data, faults = data_set(poses(*range(30)), images), {"flat": np.arange(30) == 4}
    monkeypatch.setattr("servoscope.data.checks.image_faults", pytest.fail)
    (text,) = data_set_warnings(data, faults)
    assert "1 flat (000004)" in text
