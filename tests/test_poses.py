import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation

from servoscope.errors import InvalidInputError
from servoscope.poses import (
    DISPLAY_FACTORS,
    DOFS,
    displacement_ranges,
    displacements_from_poses,
    inverse_transform,
    pose_error,
    poses_from_displacements,
    poses_from_quaternions,
    quaternions_xyzw,
    rigid_transform,
)

PAPER_RANGES = np.array([0.025] * 3 + [np.radians(15.0)] * 3)
PIVOT = 0.55

translations = hnp.arrays(float, 3, elements=st.floats(-10, 10))
rotations = hnp.arrays(float, 3, elements=st.floats(-3, 3)).map(
    lambda rvec: Rotation.from_rotvec(rvec).as_matrix()
)
transforms = st.builds(rigid_transform, rotations, translations)
displacements = hnp.arrays(float, (4, 6), elements=st.floats(-1.5, 1.5))


def explicit_rotation(rx, ry, rz):
    """Rz(rz) Ry(ry) Rx(rx), written out."""
    (cx, cy, cz), (sx, sy, sz) = np.cos([rx, ry, rz]), np.sin([rx, ry, rz])
    Rx = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    Ry = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    Rz = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return Rz @ Ry @ Rx


@given(transforms, transforms, transforms)
def test_rigid_transforms_compose_associatively_to_rigid_transforms(A, B, C):
    np.testing.assert_allclose((A @ B) @ C, A @ (B @ C), atol=1e-12)
    AB = A @ B
    np.testing.assert_allclose(AB[:3, :3] @ AB[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(AB[:3, :3]) == pytest.approx(1.0)
    assert AB[3].tolist() == [0, 0, 0, 1]


@given(transforms)
def test_the_inverse_undoes_a_transform_from_both_sides(T):
    np.testing.assert_allclose(T @ inverse_transform(T), np.eye(4), atol=1e-12)
    np.testing.assert_allclose(inverse_transform(T) @ T, np.eye(4), atol=1e-12)
    np.testing.assert_allclose(inverse_transform(T), np.linalg.inv(T), atol=1e-12)


def test_stacks_of_transforms_are_inverted_one_by_one(rng):
    T = rigid_transform(Rotation.random(6, rng).as_matrix(), rng.normal(size=(6, 3)))
    stack = T.reshape(2, 3, 4, 4)
    np.testing.assert_allclose(inverse_transform(stack), np.linalg.inv(stack), atol=1e-12)


def test_one_rotation_goes_with_many_translations(rng):
    T = rigid_transform(np.eye(3), rng.normal(size=(5, 3)))
    assert T.shape == (5, 4, 4)
    assert (T[:, :3, :3] == np.eye(3)).all()


@given(displacements, transforms, st.floats(-1, 1))
def test_displacements_come_back_from_their_poses(delta_p, T_world_ref, pivot):
    T_world_cam = poses_from_displacements(T_world_ref, delta_p, pivot)
    restored = displacements_from_poses(T_world_ref, T_world_cam, pivot)
    np.testing.assert_allclose(restored, delta_p, atol=1e-8)


@given(transforms, transforms, st.floats(-1, 1))
def test_poses_come_back_from_their_displacements(T_world_ref, T_world_cam, pivot):
    delta_p = displacements_from_poses(T_world_ref, T_world_cam[None], pivot)
    restored = poses_from_displacements(T_world_ref, delta_p, pivot)[0]
    np.testing.assert_allclose(restored, T_world_cam, atol=1e-6)


@given(transforms, transforms, st.floats(-1, 1))
def test_displacements_do_not_depend_on_the_world_frame(T_world_ref, T_other_world, pivot):
    delta_p = np.array([[0.02, -0.01, 0.005, 0.1, -0.2, 0.05]])
    T_world_cam = poses_from_displacements(T_world_ref, delta_p, pivot)
    moved = displacements_from_poses(
        T_other_world @ T_world_ref, T_other_world @ T_world_cam, pivot
    )
    np.testing.assert_allclose(moved, delta_p, atol=1e-9)


def test_the_reference_itself_is_not_displaced():
    T = rigid_transform(explicit_rotation(0.3, -0.2, 1.0), [1.0, 2.0, 3.0])
    np.testing.assert_allclose(displacements_from_poses(T, T[None], PIVOT), 0, atol=1e-12)


def test_rotations_are_about_z_after_y_after_x(rng):
    delta_p = rng.uniform(-1, 1, (20, 6))
    poses = poses_from_displacements(np.eye(4), delta_p, 0.0)
    for T, d in zip(poses, delta_p, strict=True):
        np.testing.assert_allclose(T[:3, :3], explicit_rotation(*d[3:]), atol=1e-12)
        np.testing.assert_allclose(T[:3, 3], d[:3], atol=1e-12)


def test_a_rotation_about_the_pivot_leaves_the_pivot_where_it_is():
    delta_p = np.array([[0, 0, 0, 0.2, -0.1, 0.3]])
    T_world_cam = poses_from_displacements(np.eye(4), delta_p, PIVOT)[0]
    pivot_in_camera = np.array([0, 0, PIVOT, 1.0])
    np.testing.assert_allclose(T_world_cam @ pivot_in_camera, pivot_in_camera, atol=1e-12)


def test_a_tilt_about_the_pivot_swings_the_camera_sideways():
    delta_p = np.array([[0, 0, 0, 0, np.radians(15.0), 0]])
    position = poses_from_displacements(np.eye(4), delta_p, PIVOT)[0, :3, 3]
    expected = [-PIVOT * np.sin(np.radians(15)), 0, PIVOT * (1 - np.cos(np.radians(15)))]
    np.testing.assert_allclose(position, expected, atol=1e-12)


def test_the_camera_form_reaches_the_167_mm_of_the_paper():
    camera = displacement_ranges(PAPER_RANGES, PIVOT, "camera")
    assert (1e3 * camera[:2]).round().tolist() == [167, 167]
    np.testing.assert_array_equal(camera[3:], PAPER_RANGES[3:])
    np.testing.assert_array_equal(displacement_ranges(PAPER_RANGES, PIVOT, "pivot"), PAPER_RANGES)


def test_the_corners_of_the_sampled_range_reach_the_camera_range():
    corners = np.array(np.meshgrid(*[[-1.0, 1.0]] * 6)).reshape(6, -1).T * PAPER_RANGES
    corners[:, 5] = 0.0
    tilts = np.concatenate([corners * keep for keep in ([1] * 6, [1, 1, 1, 0, 1, 1])])
    T_world_cam = poses_from_displacements(np.eye(4), tilts, PIVOT)
    reached = np.abs(displacements_from_poses(np.eye(4), T_world_cam, 0.0)).max(axis=0)
    ranges = displacement_ranges(PAPER_RANGES, PIVOT, "camera")
    np.testing.assert_allclose(reached[:5], ranges[:5], rtol=1e-12)


def test_few_sampled_displacements_leave_the_camera_range(rng):
    sampled = rng.uniform(-1, 1, (20_000, 6)) * PAPER_RANGES
    T_world_cam = poses_from_displacements(np.eye(4), sampled, PIVOT)
    delta_p = displacements_from_poses(np.eye(4), T_world_cam, 0.0)
    outside = np.abs(delta_p) > displacement_ranges(PAPER_RANGES, PIVOT, "camera") + 1e-12
    assert outside.any(axis=1).mean() < 0.02
    assert not outside[:, 2:].any()


def test_an_unknown_form_of_displacement_is_refused():
    with pytest.raises(InvalidInputError, match="one of pivot, camera, got 'flange'"):
        displacement_ranges(PAPER_RANGES, PIVOT, "flange")


@given(hnp.arrays(float, 4, elements=st.floats(-1, 1)).filter(lambda q: np.linalg.norm(q) > 1e-2))
def test_quaternions_of_any_length_give_the_same_rotation_and_come_back(quaternion):
    T = poses_from_quaternions([[1.0, 2.0, 3.0]], [quaternion])
    scaled = poses_from_quaternions([[1.0, 2.0, 3.0]], [-7 * quaternion])
    np.testing.assert_allclose(scaled, T, atol=1e-12)
    restored = quaternions_xyzw(T)[0]
    unit = quaternion / np.linalg.norm(quaternion)
    assert restored[3] >= 0
    assert abs(restored @ unit) == pytest.approx(1.0)


def test_a_quaternion_has_its_scalar_last():
    half = np.radians(90) / 2
    T = poses_from_quaternions([[0.0, 0.0, 0.0]], [[0.0, 0.0, np.sin(half), np.cos(half)]])[0]
    np.testing.assert_allclose(T[:3, :3], explicit_rotation(0, 0, np.radians(90)), atol=1e-12)


@pytest.mark.parametrize(
    ("translation", "quaternion", "message"),
    [
        ([0, 0, np.nan], [0, 0, 0, 1], r"translation must be finite, but number 1 .* \(1 in all"),
        ([0, 0, 0], [0, np.inf, 0, 1], r"quaternion must be finite, but number 1"),
        ([0, 0, 0], [0, 0, 0, 0], r"zero length, but number 1 .* \(1 in all"),
    ],
)
def test_a_pose_that_is_none_is_refused_by_its_number(translation, quaternion, message):
    with pytest.raises(InvalidInputError, match=message):
        poses_from_quaternions([[0, 0, 0], translation], [[0, 0, 0, 1], quaternion])


@given(transforms, translations, hnp.arrays(float, 3, elements=st.floats(-1.7, 1.7)))
def test_pose_error_is_the_distance_and_the_angle_between(T, offset, rvec):
    angle = np.linalg.norm(rvec)
    moved = T @ rigid_transform(Rotation.from_rotvec(rvec).as_matrix(), offset)
    distance, angle_found = pose_error(T, moved)
    assert distance == pytest.approx(np.linalg.norm(offset), abs=1e-9)
    assert angle_found == pytest.approx(angle, abs=1e-6)
    back = pose_error(moved, T)
    assert back == pytest.approx((distance, angle_found), abs=1e-9)


@given(transforms)
def test_a_pose_has_no_error_from_itself(T):
    distance, angle = pose_error(T, T)
    assert distance == 0
    assert angle == pytest.approx(0, abs=1e-7)


def test_many_poses_are_compared_with_one(rng):
    delta_p = rng.uniform(-0.1, 0.1, (7, 6))
    distance, angle = pose_error(poses_from_displacements(np.eye(4), delta_p, 0.0), np.eye(4))
    np.testing.assert_allclose(distance, np.linalg.norm(delta_p[:, :3], axis=1))
    assert angle.shape == (7,)


def test_display_factors_turn_metres_and_radians_into_mm_and_degrees():
    shown = np.array([0.025, 0, 0, np.pi / 12, 0, 0]) * DISPLAY_FACTORS
    assert shown[[0, 3]] == pytest.approx([25.0, 15.0])
    assert len(DISPLAY_FACTORS) == len(DOFS) == 6
