import sys
import warnings
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from layered_world import (
    FAR,
    FOCAL,
    HEIGHT,
    MOUNT,
    NEAR,
    WIDTH,
    photographs,
    picture,
    poses_about,
    reported,
)
from servoscope import CameraModel, Keyframe
from servoscope.errors import InvalidInputError
from servoscope.keyframe import levels, read_held_out
from servoscope.keyframe.motion import conjugate, exponential
from servoscope.poses import displacements_from_poses, inverse_transform, pose_error

N_FITTED, PIVOT = 14, 0.1
REFERENCE = photographs(np.eye(4)[None], 99)[0]


@pytest.fixture(scope="module")
def keyframe():
    displacements = poses_about(N_FITTED, 0)
    T_world_ref = reported(poses_about(1, 7)[0])
    poses = T_world_ref @ reported(displacements)
    images = photographs(displacements, 1)
    return Keyframe.fit(images, poses, REFERENCE, T_world_ref, pivot=PIVOT)


@pytest.fixture(scope="module")
def held_out():
    displacements = poses_about(12, 5)
    return photographs(displacements, 6), reported(displacements)


def errors(keyframe, images, displacements, starts=None):
    """Distances [mm] and angles [deg] between what is read and what is true."""
    starts = [None] * len(images) if starts is None else starts
    found = [keyframe.align(i, s).displacement for i, s in zip(images, starts, strict=True)]
    distance, angle = pose_error(np.stack(found), displacements)
    return 1e3 * distance, np.degrees(angle)


def test_camera_and_mount_are_found_from_images_and_flange_poses_alone(keyframe):
    distance, angle = pose_error(keyframe.mount, MOUNT)
    assert np.degrees(angle) < 0.5
    assert distance < 5e-3
    assert abs(keyframe.camera.f - FOCAL) < 0.02 * FOCAL
    assert all(keyframe.observable.values())


def test_the_relief_has_both_plates_at_their_distances(keyframe):
    depth = 1 / keyframe.inverse_depth
    rows, columns = depth.shape
    middle = depth[int(0.4 * rows) : int(0.6 * rows), int(0.4 * columns) : int(0.6 * columns)]
    edge = depth[:, [int(0.1 * columns), int(0.9 * columns)]]
    assert np.median(middle) == pytest.approx(NEAR, rel=0.02)
    assert np.median(edge) == pytest.approx(FAR, rel=0.02)


def test_held_out_images_are_read_without_a_first_guess(keyframe, held_out):
    distance, angle = errors(keyframe, *held_out)
    assert np.median(distance) < 0.5
    assert np.median(angle) < 0.05
    assert np.count_nonzero((distance < 3) & (angle < 0.5)) >= 11


def test_threads_that_share_a_keyframe_read_what_one_reads(keyframe, held_out):
    images, displacements = held_out
    alone = [keyframe.align(i, D).delta_p for i, D in zip(images, displacements, strict=True)]
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    try:
        with ThreadPoolExecutor(4) as pool:
            found = list(pool.map(keyframe.align, images, displacements))
    finally:
        sys.setswitchinterval(interval)
    np.testing.assert_array_equal([f.delta_p for f in found], alone)


def test_one_look_at_the_reference_reads_nothing(keyframe):
    found = keyframe.align(photographs(np.eye(4)[None], 3)[0], np.eye(4))
    assert np.abs(found.delta_p).max() < 2e-4
    assert found.similarity > 0.95
    assert found.share_visible > 0.95


@pytest.mark.parametrize(
    "change",
    [
        lambda image: 0.7 * image,
        lambda image: 0.8 * image + 25,
        lambda image: image * np.linspace(1.1, 0.6, WIDTH),
        lambda image: np.where(np.arange(WIDTH) < 0.2 * WIDTH, 30, image),
    ],
    ids=["gain", "gain and offset", "light that falls off", "covered by a fifth"],
)
def test_disturbed_images_are_read_from_a_first_guess(keyframe, held_out, change):
    images, displacements = held_out
    disturbed = [np.clip(change(image), 0, 255).round().astype(np.uint8) for image in images]
    starts = reported(poses_about(len(images), 0, turns=False))
    near = 0.25 * (starts - np.eye(4)) + np.eye(4)
    distance, angle = errors(keyframe, disturbed, displacements, displacements @ near)
    assert np.median(distance) < 1.5
    assert np.median(angle) < 0.2
    assert np.count_nonzero((distance < 5) & (angle < 1)) >= 11


def test_what_is_rendered_is_what_a_camera_there_sees(keyframe):
    (D,) = poses_about(1, 11)
    image, known = keyframe.render(reported(D))
    off = np.abs(image[known] - picture(D)[known])
    assert image.shape == (HEIGHT, WIDTH)
    assert known.mean() > 0.7
    assert not known.all()
    assert np.median(off) < 3
    assert np.mean(off < 15) > 0.95
    assert not image[~known].any()


def test_rendering_at_the_reference_gives_the_reference_at_any_width(keyframe):
    image, known = keyframe.render(np.eye(4))
    inner = (slice(2, -2), slice(2, -2))
    assert known[inner].mean() > 0.9
    assert np.abs(image[inner].astype(int) - REFERENCE[inner])[known[inner]].max() <= 1
    small, _ = keyframe.render(np.eye(4), width=88)
    assert small.shape == (56, 88)


def test_believed_deviations_hold_in_most_cases(keyframe, held_out):
    images, displacements = held_out
    truth = displacements_from_poses(np.eye(4), displacements, PIVOT)
    found = [keyframe.align(image, D) for image, D in zip(images, displacements, strict=True)]
    z = np.array([(f.delta_p - t) / f.std for f, t in zip(found, truth, strict=True)])
    assert 0.75 <= np.mean(np.abs(z) < 2) <= 1.0
    assert np.median(np.abs(z)) > 0.1


def test_scatter_of_looks_at_the_reference_is_near_its_bound_and_what_is_believed(keyframe):
    noise = 6.0
    clean = picture(np.eye(4))
    rng = np.random.default_rng(2)
    noisy = np.clip(clean + noise * rng.normal(size=(40, *clean.shape)), 0, 255).round()
    found = [keyframe.align(image.astype(np.uint8), np.eye(4)) for image in noisy]
    scatter = np.std([f.delta_p for f in found], axis=0, ddof=1)
    bound = keyframe.limit(noise).std
    believed = np.median([f.std for f in found], axis=0)
    assert (scatter > 0.75 * bound).all()
    assert (scatter < 2.2 * bound).all()
    assert (believed / scatter > 0.5).all()
    assert (believed / scatter < 2.0).all()


def test_limit_shrinks_with_the_noise_and_its_pixels_add_up_to_one(keyframe):
    limit = keyframe.limit(2.0)
    np.testing.assert_allclose(keyframe.limit(1.0).std, 0.5 * limit.std, rtol=1e-9)
    np.testing.assert_allclose(limit.shares.sum(axis=(1, 2)), 1, rtol=1e-4)
    assert limit.shares.shape == (6, HEIGHT, WIDTH)
    with pytest.raises(InvalidInputError, match="noise must be positive"):
        keyframe.limit(0.0)


def test_arrays_make_the_same_keyframe_again(keyframe, held_out):
    again = Keyframe.from_arrays(keyframe.to_arrays())
    image = held_out[0][0]
    np.testing.assert_array_equal(
        again.align(image).displacement, keyframe.align(image).displacement
    )
    assert again.to_arrays().keys() == keyframe.to_arrays().keys()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("mount", np.eye(3)),
        ("mount", 2 * np.eye(4)),
        ("inverse_depth", np.zeros((8, 8), np.float32)),
        ("trust", np.ones((3, 3), np.float32)),
        ("camera", np.array([np.nan, 0, 0, 0, 0])),
        ("displacements", np.zeros((0,))),
        ("reference_image", np.zeros((64, 64))),
        ("noise", np.array("x")),
    ],
)
def test_arrays_that_are_not_of_a_keyframe_are_refused(keyframe, name, value):
    with pytest.raises(InvalidInputError, match=name):
        Keyframe.from_arrays(keyframe.to_arrays() | {name: value})


def test_missing_arrays_are_named(keyframe):
    arrays = keyframe.to_arrays()
    del arrays["trust"]
    with pytest.raises(InvalidInputError, match="trust is missing"):
        Keyframe.from_arrays(arrays)


def test_an_image_of_another_size_and_a_bent_start_are_refused(keyframe):
    with pytest.raises(InvalidInputError, match="like the reference image"):
        keyframe.align(np.zeros((20, 30), np.uint8))
    with pytest.raises(InvalidInputError, match="like the reference image"):
        keyframe.align(REFERENCE.astype(float))
    with pytest.raises(InvalidInputError, match="rigid transform"):
        keyframe.align(REFERENCE, 2 * np.eye(4))
    with pytest.raises(InvalidInputError, match="rigid transform"):
        keyframe.render(np.full((4, 4), np.nan))


def test_an_image_without_any_detail_breaks_nothing_and_is_not_similar(keyframe):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = keyframe.align(np.full_like(REFERENCE, 128))
    assert np.isfinite(found.covariance).all()
    assert found.similarity < 0.2


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"images": np.zeros((8, 112, 176))}, "images must be a uint8 array"),
        ({"images": np.zeros((8, 60, 60), np.uint8)}, "as large as the reference image"),
        ({"images": np.zeros((3, 112, 176), np.uint8)}, "at least 6 images"),
        ({"T_world_cam": np.eye(4)}, "T_world_cam must hold rigid transforms"),
        ({"T_world_ref": np.full((4, 4), np.nan)}, "T_world_ref must hold rigid transforms"),
        ({"reference_image": np.full((112, 176), 90, np.uint8)}, "some detail"),
        ({"pose_noise": (-1.0, 0.1)}, "pose_noise"),
        ({"mount": np.zeros((4, 4))}, "mount must"),
        ({"pivot": np.inf}, "pivot"),
        ({"pivot": "far"}, "pivot must be a finite distance"),
        ({"distance": None}, "distance must be positive"),
        ({"pose_noise": 1e-3}, "pose_noise must be two"),
        ({"pose_noise": ("a", "b")}, "pose_noise must be an array of numbers"),
        ({"T_world_cam": "poses"}, "T_world_cam must be an array of numbers"),
        ({"T_world_ref": [[1.0, 0.0], [0.0]]}, "T_world_ref must be an array of numbers"),
        ({"mount": 1j * np.eye(4)}, "mount must be an array of numbers"),
    ],
)
def test_bad_input_is_refused_in_one_line(change, message):
    good = {
        "images": np.zeros((8, 112, 176), np.uint8),
        "T_world_cam": np.tile(np.eye(4), (8, 1, 1)),
        "reference_image": REFERENCE,
        "T_world_ref": np.eye(4),
    }
    with pytest.raises(InvalidInputError, match=message) as error:
        Keyframe.fit(**good | change)
    assert "\n" not in str(error.value)


def test_rotations_alone_leave_depth_unknown_and_are_read_all_the_same():
    displacements = poses_about(8, 3, moves=False)
    images = photographs(displacements, 4)
    camera = CameraModel(FOCAL)
    keyframe = Keyframe.fit(images, displacements, REFERENCE, np.eye(4), camera=camera)
    assert not keyframe.observable["depth"]
    assert keyframe.observable["mount_rotation"]
    (D,) = poses_about(1, 8, moves=False)
    found = keyframe.align(photographs(D[None], 9)[0])
    error = Rotation.from_matrix(found.displacement[:3, :3].T @ D[:3, :3]).magnitude()
    assert np.degrees(error) < 0.1
    assert found.std[:3].min() > 0.05
    assert np.abs(found.displacement[:3, 3]).max() < 1e-3


def test_a_known_camera_is_kept_and_a_fit_repeats_bit_for_bit():
    displacements = poses_about(6, 0)
    camera, images = CameraModel(FOCAL), photographs(displacements, 1)
    first, second = (
        Keyframe.fit(
            images, reported(displacements), REFERENCE, np.eye(4), camera=camera, mount=MOUNT
        )
        for _ in range(2)
    )
    np.testing.assert_array_equal(first.camera.values, camera.values)
    assert pose_error(first.mount, MOUNT)[0] < 5e-3
    for name, array in first.to_arrays().items():
        np.testing.assert_array_equal(array, second.to_arrays()[name])


def test_the_frame_of_the_poses_does_not_matter(keyframe):
    D = reported(poses_about(1, 21)[0])
    T_world_ref = reported(poses_about(1, 22)[0])
    image = photographs(poses_about(1, 21), 23)[0]
    found = keyframe.align(image)
    assert pose_error(T_world_ref @ found.displacement, T_world_ref @ D)[0] < 3e-3
    np.testing.assert_allclose(
        found.delta_p, displacements_from_poses(np.eye(4), found.displacement[None], PIVOT)[0]
    )
    assert inverse_transform(found.displacement).shape == (4, 4)


def test_groups_are_read_by_keyframes_that_never_saw_them():
    displacements = poses_about(12, 2)
    images, poses = photographs(displacements, 3), reported(displacements)
    wrong = images.copy()
    wrong[:6] = photographs(poses_about(6, 31), 4)  # of other displacements than are reported
    options = {"camera": CameraModel(FOCAL), "mount": MOUNT, "pivot": PIVOT}
    groups = np.repeat([0, 1], 6)
    looks = read_held_out(wrong, poses, REFERENCE, np.eye(4), groups, **options)
    assert looks.errors.shape == looks.std.shape == (12, 6)
    off = np.linalg.norm(looks.errors[:, :3], axis=1)
    assert np.median(off[:6]) > 0.01  # read well, by the good half, hence off what is reported
    assert (looks.similarity[:6] > 0.8).all()
    with pytest.raises(InvalidInputError, match="two groups or more"):
        read_held_out(images, poses, REFERENCE, np.eye(4), np.zeros(12))


def test_lengthened_steps_end_nearer(keyframe, held_out, monkeypatch):
    level, errors = keyframe.aligner.levels[-1], {}
    for most in (levels.MOST_RELAXED, 1.0):
        monkeypatch.setattr(levels, "MOST_RELAXED", most)
        left = []
        for image, displacement in zip(*held_out, strict=True):
            T = inverse_transform(conjugate(keyframe.mount, displacement))
            start = level.start(exponential([0.0, 0.0, 0.0, 2e-3, -2e-3, 2e-3]) @ T)
            grey = level.prepare(image)
            few, many = (level.descend(grey, start, n, tolerance=0.0).T for n in (5, 30))
            left.append(keyframe.aligner.view_shift(inverse_transform(many) @ few))
        errors[most] = np.median(left)
    assert errors[max(errors)] < 0.6 * errors[1.0]
