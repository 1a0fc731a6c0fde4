import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from servoscope.errors import InvalidInputError, ServoscopeWarning
from servoscope.formats import T_world_cam_from_numbers

coordinate = st.floats(-3, 3, allow_nan=False)


def as_written(T_world_cam, direction, units, quaternion_order, axes):
    """The seven numbers that a program with these conventions would write for a pose."""
    T = T_world_cam.copy()
    if axes == "opengl":
        T[:3, 1:3] *= -1  # its y and z axes, in world coordinates, point the other way
    if direction == "world-to-camera":
        T = np.linalg.inv(T)
    x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat()
    quaternion = [x, y, z, w] if quaternion_order == "xyzw" else [w, x, y, z]
    return [*(T[:3, 3] * (1000 if units == "mm" else 1)), *quaternion]


@given(
    rotation=st.tuples(*[coordinate] * 3),
    translation=st.tuples(*[coordinate] * 3),
    direction=st.sampled_from(["camera-to-world", "world-to-camera"]),
    units=st.sampled_from(["m", "mm"]),
    quaternion_order=st.sampled_from(["xyzw", "wxyz"]),
    axes=st.sampled_from(["opencv", "opengl"]),
)
def test_a_pose_written_in_any_convention_reads_back_the_same(
    rotation, translation, direction, units, quaternion_order, axes
):
    T_world_cam = np.eye(4)
    T_world_cam[:3, :3] = Rotation.from_rotvec(rotation).as_matrix()
    T_world_cam[:3, 3] = translation
    numbers = as_written(T_world_cam, direction, units, quaternion_order, axes)
    T = T_world_cam_from_numbers(
        [numbers], direction=direction, units=units, quaternion_order=quaternion_order, axes=axes
    )
    np.testing.assert_allclose(T[0], T_world_cam, atol=1e-12)


def test_an_opengl_camera_with_identity_pose_looks_along_minus_z():
    T = T_world_cam_from_numbers([[0, 0, 0, 0, 0, 0, 1]], axes="opengl")[0]
    np.testing.assert_array_equal(T[:3, :3] @ [0, 0, 1], [0, 0, -1])
    np.testing.assert_array_equal(T[:3, :3] @ [0, 1, 0], [0, -1, 0])


def test_quaternions_far_from_unit_length_are_told():
    rows = [[0, 0, 0, 0, 0, 0, 1], [0, 0, 0, 0, 0, 0, 0.5]]
    with pytest.warns(ServoscopeWarning, match=r"1 of 2 quaternions .* \(0.5 to 1\)"):
        T_world_cam_from_numbers(rows)


def test_rounded_quaternions_pass_silently():
    T_world_cam_from_numbers([[0, 0, 0, 0.6504, 0.6012, -0.3056, -0.3496]])


def test_a_quaternion_of_zero_length_is_refused():
    with (
        pytest.raises(InvalidInputError, match="zero length"),
        pytest.warns(ServoscopeWarning, match="unit length"),
    ):
        T_world_cam_from_numbers([[0, 0, 0, 0, 0, 0, 0]])
