"""Conventions of poses: what each means is worked out by hand, and as SciPy has it."""

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from servoscope.errors import InvalidInputError
from servoscope.formats import CONVENTIONS, find_convention, poses_from_numbers
from servoscope.formats.conventions import problem_of_pose
from servoscope.formats.pose_table import TableOptions

PAGE = (Path(__file__).parents[2] / "docs" / "conventions.md").read_text(encoding="utf-8")


def turn(axis, angle):
    """The elementary rotation about an axis, written out."""
    cos, sin = np.cos(angle), np.sin(angle)
    return {
        "x": np.array([[1, 0, 0], [0, cos, -sin], [0, sin, cos]]),
        "y": np.array([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]]),
        "z": np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]),
    }[axis]


EULER = {
    "kuka-abc": ("zyx", np.pi / 180),
    "fanuc-wpr": ("xyz", np.pi / 180),
    "yaskawa-rxryrz": ("xyz", np.pi / 180),
    "ros-rpy": ("xyz", 1.0),
    "staubli-rxryrz": ("xyz", np.pi / 180),
    "kawasaki-oat": ("zyz", np.pi / 180),
    "mitsubishi-abc": ("xyz", np.pi / 180),
    "epson-uvw": ("zyx", np.pi / 180),
    "techman-rxryrz": ("xyz", np.pi / 180),
    "ufactory-rpy": ("xyz", np.pi / 180),
    "mecademic-abc": ("xyz", np.pi / 180),
    "doosan-abc": ("zyz", np.pi / 180),
    "adept-ypr": ("zyz", np.pi / 180),
    "comau-zyz": ("zyz", np.pi / 180),
}
IN_THE_BODY = {"kuka-abc": "ZYX", "staubli-rxryrz": "XYZ", "kawasaki-oat": "ZYZ"} | {
    "epson-uvw": "ZYX", "mecademic-abc": "XYZ", "doosan-abc": "ZYZ", "adept-ypr": "ZYZ",
    "comau-zyz": "ZYZ",
}  # fmt: skip


@pytest.mark.parametrize("name", EULER)
def test_angles_turn_one_after_the_other_about_the_axes_that_the_convention_names(name):
    axes, radians = EULER[name]
    angles = np.array([10.0, -35.0, 70.0]) * np.pi / 180 / radians
    turns = [turn(axis, radians * angle) for axis, angle in zip(axes, angles, strict=True)]
    a, b, c = turns if name in IN_THE_BODY else turns[::-1]
    T = poses_from_numbers([[0, 0, 0, *angles]], find_convention(name), length_unit="m")
    np.testing.assert_allclose(T[0, :3, :3], a @ b @ c, atol=1e-12)


PUBLISHED = {
    "kuka-abc": "KUKA_2_Pose",
    "fanuc-wpr": "Fanuc_2_Pose",
    "yaskawa-rxryrz": "Motoman_2_Pose",
    "techman-rxryrz": "Techman_2_Pose",
    "staubli-rxryrz": "Pose",
    "mecademic-abc": "Pose",
    "adept-ypr": "Adept_2_Pose",
    "comau-zyz": "Comau_2_Pose",
    "ur": "UR_2_Pose",
}


@pytest.mark.parametrize("name", PUBLISHED)
def test_poses_are_those_of_robodk(name):
    robomath = pytest.importorskip("robodk.robomath")
    turned = [0.4, 1.2, -0.3] if name == "ur" else [35.0, -50.0, 170.0]
    numbers = [100.0, -20.0, 30.0, *turned]
    convert = getattr(robomath, PUBLISHED[name])
    theirs = np.array((convert(*numbers) if convert is robomath.Pose else convert(numbers)).Rows())
    theirs[:3, 3] /= 1000
    T = poses_from_numbers([numbers], find_convention(name), length_unit="mm")[0]
    np.testing.assert_allclose(T, theirs, atol=1e-12)


def quaternion_of_baslers_manual(about_z, about_y, about_x):
    """The quaternion, as the rc_visard manual writes it for KUKA, Fanuc, Mitsubishi and Yaskawa."""
    (sz, sy, sx), (cz, cy, cx) = (
        f(np.radians([about_z, about_y, about_x]) / 2) for f in (np.sin, np.cos)
    )
    return [
        cz * cy * sx - sz * sy * cx,
        cz * sy * cx + sz * cy * sx,
        sz * cy * cx - cz * sy * sx,
        cz * cy * cx + sz * sy * sx,
    ]


@pytest.mark.parametrize(
    ("name", "angles"),
    [
        ("kuka-abc", [170.0, -50.0, 35.0]),
        ("fanuc-wpr", [35.0, -50.0, 170.0]),
        ("mitsubishi-abc", [35.0, -50.0, 170.0]),
        ("yaskawa-rxryrz", [35.0, -50.0, 170.0]),
    ],
)
def test_angles_are_the_quaternion_of_baslers_manual(name, angles):
    expected = Rotation.from_quat(quaternion_of_baslers_manual(170.0, -50.0, 35.0)).as_matrix()
    T = poses_from_numbers([[0, 0, 0, *angles]], find_convention(name), length_unit="mm")
    np.testing.assert_allclose(T[0, :3, :3], expected, atol=1e-12)


@pytest.mark.parametrize(
    ("said", "meant"),
    [
        ("KUKA_ABC", "kuka-abc"), ("kuka", "kuka-abc"), ("Fanuc WPR", "fanuc-wpr"), ("UR", "ur"),
        ("Stäubli", "staubli-rxryrz"), ("XYZW", "xyzw"), ("abb", "abb-quaternion"),
    ],
)  # fmt: skip
def test_names_are_known_however_they_are_written(said, meant):
    assert find_convention(said) is CONVENTIONS[meant]


def test_a_rotation_vector_is_the_axis_times_the_angle():
    for name in ("ur", "rotvec"):
        T = poses_from_numbers([[0, 0, 0, 0, 0.7, 0]], find_convention(name), length_unit="m")
        np.testing.assert_allclose(T[0, :3, :3], turn("y", 0.7), atol=1e-12)


def test_quaternions_differ_in_where_the_scalar_stands():
    half = 0.35
    for name in ("wxyz", "abb-quaternion"):
        numbers = [0, 0, 0, np.cos(half), 0, np.sin(half), 0]
        T = poses_from_numbers([numbers], find_convention(name), length_unit="m")
        np.testing.assert_allclose(T[0, :3, :3], turn("y", 0.7), atol=1e-12)
    numbers = [0, 0, 0, 0, np.sin(half), 0, np.cos(half)]
    T = poses_from_numbers([numbers], find_convention("xyzw"), length_unit="m")
    np.testing.assert_allclose(T[0, :3, :3], turn("y", 0.7), atol=1e-12)


ORDERS = ["xyz", "zyx", "yzx", "zxz", "XYZ", "ZYX", "YXY"]


@given(order=st.sampled_from(ORDERS), angles=st.tuples(*[st.floats(-170, 170)] * 3))
def test_an_order_of_axes_is_scipys(order, angles):
    convention = find_convention(order)
    T = poses_from_numbers([[1000, 2, 3, *angles]], convention, length_unit="mm", angle_unit="deg")[
        0
    ]
    R = Rotation.from_euler(order, angles, degrees=True).as_matrix()
    np.testing.assert_allclose(T[:3, :3], R, atol=1e-12)
    np.testing.assert_allclose(T[:3, 3], [1.0, 0.002, 0.003])


@pytest.mark.parametrize("name", ["xxy", "xyZ", "abc", "zy", "zyxz", "kuka-ab", ""])
def test_what_is_no_convention_is_refused_with_those_there_are(name):
    with pytest.raises(InvalidInputError, match=f"kuka-abc, .* got '{name}'"):
        TableOptions(rotation=name)


def test_the_unit_of_an_order_of_axes_must_be_said():
    with pytest.raises(InvalidInputError, match="angle-unit deg or --angle-unit rad"):
        TableOptions(rotation="zyx")
    assert TableOptions(rotation="zyx", angle_unit="deg").length_unit == "m"
    with pytest.raises(InvalidInputError, match="angle_unit deg has no angles"):
        TableOptions(rotation="wxyz", angle_unit="deg")


@pytest.mark.parametrize(
    ("name", "numbers", "problem"),
    [
        ("ur", [0, 0, 0, 30, 0, 0], "beyond a whole turn; are they in deg"),
        ("kuka-abc", [0, 0, 0, 0, 400, 0], "beyond a whole turn; mend the line"),
        ("kuka-abc", [0, 1e12, 0, 0, 0, 0], "is in no room; check --units"),
        ("wxyz", [0, 0, 0, 0, 0, 0, 0], "zero length"),
        ("matrix", [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 2, 0], "must be orthonormal"),
        ("matrix", [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, -1, 0], "mirrors"),
        ("matrix", [1, 0, 0, 0, 0, 1e300, 0, 0, 0, 0, 1, 0], "must be orthonormal"),
    ],
)
def test_numbers_that_are_no_pose_are_known(name, numbers, problem):
    said = problem_of_pose(numbers, CONVENTIONS[name], length_unit="mm")
    assert problem in said


def test_rounded_matrices_become_rotations():
    R = Rotation.from_rotvec([0.3, -0.4, 1.0]).as_matrix().round(3)
    numbers = np.column_stack([R, [1, 2, 3]]).ravel()
    assert not problem_of_pose(numbers.tolist(), CONVENTIONS["matrix"], length_unit="m")
    T = poses_from_numbers([numbers], CONVENTIONS["matrix"], length_unit="m")[0]
    np.testing.assert_allclose(T[:3, :3].T @ T[:3, :3], np.eye(3), atol=1e-12)
    np.testing.assert_allclose(T[:3, :3], R, atol=2e-3)


# The page


def rows_of_page():
    """Name, numbers and matrix of each worked number in docs/conventions.md."""
    table = PAGE[PAGE.index("## Rotations in numbers") :]
    rows = re.findall(r"^\| `(\w[\w-]*)` \|(.*)\|$", table, re.MULTILINE)
    return {name: [cell.strip() for cell in cells.split("|")] for name, cells in rows}


def scipys(name, numbers):
    """The rotation of worked numbers by SciPy's own names."""
    if name in ("matrix", "franka"):
        return np.reshape(numbers, (3, 3), order="F" if name == "franka" else "C")
    if name in ("ur", "rotvec"):
        return Rotation.from_rotvec(numbers).as_matrix()
    if name in ("xyzw", "wxyz", "abb-quaternion"):
        return Rotation.from_quat(numbers, scalar_first=name != "xyzw").as_matrix()
    return Rotation.from_euler(
        IN_THE_BODY.get(name, "xyz"), numbers, degrees=name != "ros-rpy"
    ).as_matrix()


def test_the_page_works_out_a_number_for_every_convention():
    rows = rows_of_page()
    assert set(rows) == set(CONVENTIONS)
    for name, (_, numbers, _, units, example, matrix, published) in rows.items():
        assert published, name
        convention = CONVENTIONS[name]
        values = [float(text) for text in example.split()]
        shown = np.array([[float(x) for x in row.split()] for row in matrix.split("/")])
        np.testing.assert_allclose(scipys(name, values), shown, atol=6e-4, err_msg=name)
        assert tuple(values) == convention.example
        assert units == ", ".join(filter(None, (convention.length_unit, convention.angle_unit)))
        named = [c for c in convention.columns if c not in ("tx", "ty", "tz")]
        if not convention.is_matrix:
            assert numbers.replace("`", "").split() == named
