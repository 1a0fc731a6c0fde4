"""Poses as text: any convention reads back the same; names that contradict it are refused."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from servoscope.errors import DataSetError, InvalidInputError, ServoscopeWarning
from servoscope.formats import T_world_cam_from_numbers, TumOptions, read_tum
from servoscope.formats.pose_text import check_pose_header

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


def test_quaternions_far_from_unit_length_are_warned_of():
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


SCALAR_LAST = [
    "# timestamp tx ty tz qx qy qz qw",
    "#timestamp,tx,ty,tz,qx,qy,qz,qw",
    "# time [s] pos_x [m] pos_y [m] pos_z [m] quat_x quat_y quat_z quat_w",
    "# stamp pose.position.x pose.position.y pose.position.z pose.orientation.x "
    "pose.orientation.y pose.orientation.z pose.orientation.w",
    "# t x y z x y z w",
    "# quaternions as xyzw",
]
SCALAR_FIRST = [
    "# timestamp tx ty tz qw qx qy qz",
    "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], "
    "q_RS_z [], v_RS_R_x [m s^-1]",
    "# TX TY TZ QW QX QY QZ",
    "% timestamp | tx | ty | tz | qw | qx | qy | qz",
    "// timestamp translation(x y z) quaternion(w x y z)",
    "# timestamp tx ty tz (qw qx qy qz)",
    "# quaternion order: wxyz",
    "# quaternions: qw, qx, qy, qz",
    "timestamp tx(m) ty(m) tz(m) q_w q_x q_y q_z",
]
NO_HEADER = [
    "# ground truth trajectory",
    "# file: 'rgbd_dataset_freiburg1_rpy.bag'",
    "# by x y z",
    "# quaternion: q = w + x i + y j + z k, poses of the camera",
    "#",
    "1.0 0 0 0 0 0 0 1",
]


@pytest.mark.parametrize("line", [*SCALAR_LAST, *NO_HEADER])
def test_names_that_agree_pass(line):
    check_pose_header(line, "xyzw", "line 1")


@pytest.mark.parametrize("line", [*SCALAR_FIRST, *NO_HEADER])
def test_scalar_first_names_pass_where_that_is_read(line):
    check_pose_header(line, "wxyz", "line 1")


@pytest.mark.parametrize(
    ("line", "order", "advice"),
    [
        *[(line, "xyzw", "say --quaternion-order wxyz") for line in SCALAR_FIRST],
        *[(line, "wxyz", "say --quaternion-order xyzw") for line in SCALAR_LAST],
        ("# timestamp qw qx qy qz tx ty tz", "xyzw", "put the columns in that order"),
        ("# timestamp ty tx tz qx qy qz qw", "xyzw", "put the columns in that order"),
    ],
)
def test_names_that_contradict_are_refused(line, order, advice):
    with pytest.raises(DataSetError, match=advice):
        check_pose_header(line, order, "line 1")


@pytest.mark.parametrize("mark", ["# ", ""])
def test_a_sequence_whose_header_contradicts_is_refused_even_when_skipping(pose_folder, mark):
    pose_folder.write_tum()
    path = pose_folder.path / "groundtruth.txt"
    path.write_text(f"{mark}timestamp tx ty tz qw qx qy qz\n{path.read_text()}")
    options = TumOptions(reference="02.png", skip_bad=True)
    with pytest.raises(DataSetError, match="'tx ty tz qw qx qy qz', but are read as"):
        read_tum(pose_folder.path, options)
