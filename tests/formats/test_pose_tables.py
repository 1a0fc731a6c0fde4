"""Poses in whatever table or file: the same set comes back, or one line says what is wrong."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from servoscope.cli import main
from servoscope.data.images import PoseImageSet
from servoscope.errors import DataSetError, InvalidInputError, ServoscopeWarning
from servoscope.formats import FolderOptions, find_convention, read_folder

DATA = Path(__file__).parents[3] / "shared" / "data"


def numbers_in(convention, rotations):
    """What a program that writes this convention writes for rotations."""
    if convention == "matrix":
        raise AssertionError("matrices hold the translation too")
    if convention in ("ur", "rotvec"):
        return rotations.as_rotvec()
    if convention in ("xyzw", "wxyz", "abb-quaternion"):
        return rotations.as_quat(scalar_first=convention != "xyzw")
    orders = {"kuka-abc": "ZYX", "staubli-rxryrz": "XYZ", "kawasaki-oat": "ZYZ"}
    named = convention if convention.lower().strip("xyz") == "" else "xyz"
    return rotations.as_euler(orders.get(convention, named), degrees=convention != "ros-rpy")


def write(source, name, convention, *, delimiter=",", header=True, mm=False, named=True):
    """A table of the poses of a source, as somebody may write it."""
    rotations = Rotation.from_quat(source.quaternions)
    translations = source.translations * (1000 if mm else 1)
    if convention == "franka":
        numbers = source.T_world_cam.swapaxes(1, 2).reshape(-1, 16)
    elif convention == "matrix":
        T = np.concatenate([rotations.as_matrix(), translations[:, :, None]], axis=2)
        numbers = T.reshape(len(T), 12)
    else:
        numbers = np.hstack([translations, numbers_in(convention, rotations)])
    columns = find_convention(convention).columns
    lines = [delimiter.join([*(["file"] if named else []), *columns])] if header else []
    for image, row in zip(source.names, numbers.tolist(), strict=True):
        lines.append(delimiter.join([*([image] if named else []), *map(repr, row)]))
    (source.path / name).write_text("\n".join(lines) + "\n")


def options(convention, **others):
    unit = {"angle_unit": "deg"} if convention.strip("xyzXYZ") == "" else {}
    if convention in ("xyzw", "wxyz"):
        unit = {}
    return FolderOptions(
        rotation=convention, reference="02.png", poses="robot.txt", **unit, **others
    )


ALL = [
    *(
        "xyzw",
        "wxyz",
        "matrix",
        "franka",
        "ur",
        "rotvec",
        "abb-quaternion",
        "kuka-abc",
        "fanuc-wpr",
    ),
    *("yaskawa-rxryrz", "staubli-rxryrz", "kawasaki-oat", "ros-rpy", "zyx", "YXZ"),
]


@pytest.mark.filterwarnings("ignore:Gimbal lock")
@pytest.mark.parametrize("header", [True, False])
@pytest.mark.parametrize("convention", ALL)
def test_any_convention_reads_back_the_same_poses(pose_folder, convention, header):
    mm = find_convention(convention).length_unit == "mm"
    write(pose_folder, "robot.txt", convention, header=header, mm=mm)
    data = read_folder(pose_folder.path, options(convention))
    np.testing.assert_allclose(data.T_world_cam, pose_folder.T_world_cam, atol=1e-9)
    assert data.names == pose_folder.names
    assert data.source["options"]["units"] == ("mm" if mm else "m")


@pytest.mark.parametrize("delimiter", [";", "\t", "|", "  ", " , "])
@pytest.mark.parametrize("header", [True, False])
def test_any_delimiter_is_found(pose_folder, delimiter, header):
    write(pose_folder, "robot.txt", "ur", delimiter=delimiter, header=header)
    data = read_folder(pose_folder.path, options("ur"))
    np.testing.assert_allclose(data.T_world_cam, pose_folder.T_world_cam, atol=1e-12)


@pytest.mark.parametrize("name_last", [False, True])
@pytest.mark.parametrize("header", [True, False])
def test_names_with_gaps_between_spaces(pose_folder, name_last, header):
    pose_folder.names = [f"shot  no {i}.png" for i in range(6)]
    for name, image in zip(pose_folder.names, pose_folder.images, strict=True):
        pose_folder.write_image(name, image)
    write(pose_folder, "robot.txt", "ur", delimiter=" ", header=header)
    path = pose_folder.path / "robot.txt"
    if name_last:
        lines = path.read_text().splitlines()
        n = 6
        path.write_text(
            "\n".join(
                " ".join([*line.split(" ")[-n:], " ".join(line.split(" ")[:-n])]) for line in lines
            )
        )
    asked = FolderOptions(rotation="ur", poses="robot.txt", reference="shot  no 2.png")
    data = read_folder(pose_folder.path, asked)
    assert data.names == pose_folder.names
    np.testing.assert_allclose(data.T_world_cam, pose_folder.T_world_cam, atol=1e-12)


@pytest.mark.parametrize("before", ["p[", "[", "("])
def test_poses_in_brackets_are_read_and_names_keep_theirs(pose_folder, before):
    (pose_folder.path / "03.png").rename(pose_folder.path / "03 (1).png")
    pose_folder.names[3] = "03 (1).png"
    write(pose_folder, "robot.txt", "ur", header=False)
    path = pose_folder.path / "robot.txt"
    after = ")" if before == "(" else "]"
    rows = [line.replace(",", f",{before}", 1) + after for line in path.read_text().splitlines()]
    path.write_text("\n".join(rows))
    data = read_folder(pose_folder.path, options("ur"))
    np.testing.assert_allclose(data.T_world_cam, pose_folder.T_world_cam, atol=1e-12)


def test_decimal_commas_are_read_when_that_is_said_and_else_refused(pose_folder):
    write(pose_folder, "robot.txt", "ur", delimiter=";")
    path = pose_folder.path / "robot.txt"
    lines = path.read_text().splitlines()
    rows = [
        ";".join([c if c.endswith("png") else c.replace(".", ",") for c in line.split(";")])
        for line in lines
    ]
    path.write_text("\n".join(rows))
    data = read_folder(pose_folder.path, options("ur", decimal="comma"))
    np.testing.assert_allclose(data.T_world_cam, pose_folder.T_world_cam, atol=1e-12)
    with pytest.raises(DataSetError, match=r"line 2: tx must be .* got '0,0'; write decimals with"):
        read_folder(pose_folder.path, options("ur"))


def test_columns_are_named_or_numbered(pose_folder):
    write(pose_folder, "robot.txt", "kuka-abc", mm=True)
    path = pose_folder.path / "robot.txt"
    path.write_text(path.read_text().replace("file,tx,ty,tz,a,b,c", "Bild,E,N,U,Rot1,Rot2,Rot3"))
    for columns in ("E,N,U,Rot1,Rot2,Rot3", "2,3,4,5,6,7"):
        for name in ("Bild", "1"):
            asked = options("kuka-abc", columns=columns, name_column=name)
            data = read_folder(pose_folder.path, asked)
            np.testing.assert_allclose(data.T_world_cam, pose_folder.T_world_cam, atol=1e-9)
    with pytest.raises(DataSetError, match="columns must name 6 numbers"):
        read_folder(pose_folder.path, options("kuka-abc", columns="E,N"))
    with pytest.raises(DataSetError, match="has no column 'w', which --columns names"):
        read_folder(pose_folder.path, options("kuka-abc", columns="E,N,U,Rot1,Rot2,w"))


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ("file,X [m],Y [m],Z [m],A,B,C", "says 'X [m]', but mm are read; say --units m"),
        ("file,x,y,z,a_rad,b_rad,c_rad", "says 'a_rad', but deg are read; say --angle-unit rad"),
    ],
)
def test_units_in_a_header_must_not_contradict(pose_folder, header, message):
    write(pose_folder, "robot.txt", "kuka-abc", mm=True)
    path = pose_folder.path / "robot.txt"
    path.write_text(path.read_text().replace("file,tx,ty,tz,a,b,c", header))
    with pytest.raises(DataSetError) as caught:
        read_folder(pose_folder.path, options("kuka-abc"))
    assert message in str(caught.value)


def test_without_a_header_the_convention_must_be_said(pose_folder):
    write(pose_folder, "robot.txt", "ur", header=False)
    with pytest.raises(DataSetError, match=r"line 1: there is no header.*--rotation \(xyzw"):
        read_folder(pose_folder.path, FolderOptions(poses="robot.txt"))


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (
            lambda f: [*f[:6], "95"],
            "line 3: the angles [0.0, 0.0, 95.0] rad go beyond a whole turn",
        ),
        (lambda f: [*f[:5], "zero", f[6]], "line 3: ry must be a finite number, got 'zero'"),
        (lambda f: [f[0], "1e9", *f[2:]], "line 3: the translation"),
        (lambda f: f[:6], "line 3 has 6 cells, but the first line has 7 columns"),
    ],
)
def test_a_bad_row_is_refused_by_line_or_skipped(pose_folder, edit, message):
    pose_folder.quaternions[:, :3] = 0.0
    pose_folder.quaternions[:, 3] = 1.0
    write(pose_folder, "robot.txt", "ur")
    path = pose_folder.path / "robot.txt"
    lines = path.read_text().splitlines()
    lines[2] = ",".join(edit(lines[2].split(",")))
    path.write_text("\n".join(lines))
    with pytest.raises(DataSetError) as caught:
        read_folder(pose_folder.path, options("ur"))
    assert message in str(caught.value)
    assert "robot.txt" in str(caught.value)
    with pytest.warns(ServoscopeWarning, match=r"1 with an unusable pose \(01.png\)"):
        assert len(read_folder(pose_folder.path, options("ur", skip_bad=True))) == 5


# Rows and files without names


def test_rows_without_names_are_joined_to_the_images_in_natural_order(pose_folder):
    for i, name in enumerate(pose_folder.names):
        (pose_folder.path / name).rename(pose_folder.path / f"im{i + 7}.png")
    pose_folder.names = [f"im{i + 7}.png" for i in range(6)]
    write(pose_folder, "robot.txt", "matrix", delimiter="\t", header=False, named=False)
    asked = FolderOptions(rotation="matrix", poses="robot.txt", reference_index=2)
    data = read_folder(pose_folder.path, asked)
    assert data.names == ["im7.png", "im8.png", "im9.png", "im10.png", "im11.png", "im12.png"]
    np.testing.assert_allclose(data.T_world_cam, pose_folder.T_world_cam, atol=1e-12)
    (pose_folder.path / "im9.png").unlink()
    with pytest.raises(DataSetError, match=r"has 6 poses, but .* holds 5 images"):
        read_folder(pose_folder.path, asked)


@pytest.mark.parametrize("shape", ["16 in rows", "12 in a row", "4 x 4"])
def test_one_file_an_image(pose_folder, shape):
    for name, T in zip(pose_folder.names, pose_folder.T_world_cam, strict=True):
        text = {
            "16 in rows": "\n".join(map(repr, T.ravel().tolist())),
            "12 in a row": ", ".join(map(repr, T[:3].ravel().tolist())),
            "4 x 4": str(T.tolist()).replace("], [", "],\n ["),
        }[shape]
        (pose_folder.path / f"poses-{name[:-4]}.txt").write_text(text)
    asked = FolderOptions(rotation="matrix", poses="poses-*.txt", reference="02.png")
    data = read_folder(pose_folder.path, asked)
    np.testing.assert_allclose(data.T_world_cam, pose_folder.T_world_cam, atol=1e-12)
    (pose_folder.path / "poses-03.txt").write_text("1 0 0")
    with pytest.raises(DataSetError, match=r"poses-03.txt must hold 12 or 16 numbers .* got 3"):
        read_folder(pose_folder.path, asked)
    (pose_folder.path / "04.png").unlink()
    with pytest.raises(DataSetError, match=r"poses-04.txt has no image '\*' of its name \(1 such"):
        read_folder(pose_folder.path, asked)
    with pytest.warns(ServoscopeWarning, match=r"4 frames kept.*poses without an image"):
        data = read_folder(pose_folder.path, FolderOptions(
            rotation="matrix", poses="poses-*.txt", reference="02.png", skip_bad=True
        ))  # fmt: skip
    assert data.names == ["00.png", "01.png", "02.png", "05.png"]


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        (
            "1 0 0 0  0 1 0 0  0 0 1 0  0.1 0.2 0.3 1",
            "0 0 0 1, got 0.1 0.2 0.3 1; does it stand col",
        ),
        ("2 0 0 0  0 2 0 0  0 0 2 0  0 0 0 1", "must be orthonormal"),
        ("1 0 0 0  0 1 0 0  0 0 -1 0  0 0 0 1", "mirrors"),
    ],
)
def test_matrices_that_are_none_are_refused_by_line(pose_folder, matrix, message):
    write(pose_folder, "robot.txt", "matrix", delimiter=" ", header=False)
    path = pose_folder.path / "robot.txt"
    lines = [f"{line} 0 0 0 1" for line in path.read_text().splitlines()]
    path.write_text("\n".join(lines))
    assert len(read_folder(pose_folder.path, options("matrix"))) == 6
    lines[1] = f"01.png {matrix}"
    path.write_text("\n".join(lines))
    with pytest.raises(DataSetError) as caught:
        read_folder(pose_folder.path, options("matrix"))
    assert "line 2" in str(caught.value)
    assert message in str(caught.value)


# Sessions


def part_poses():
    monday, tuesday = np.eye(4), np.eye(4)
    monday[:3, 3] = 0.4, -0.1, 0.02
    tuesday[:3, :3] = Rotation.from_rotvec([0, 0, 1.1]).as_matrix()
    tuesday[:3, 3] = 0.2, 0.3, 0.02
    return {"monday": monday, "tuesday": tuesday}


def write_session(source, place, session, rows, extra=""):
    """Images of the same part, which the robot sees elsewhere."""
    lines = []
    for i in rows:
        T = part_poses()[session] @ source.T_world_cam[i]
        rotvec = Rotation.from_matrix(T[:3, :3]).as_rotvec()
        numbers = ",".join(map(repr, [*T[:3, 3].tolist(), *rotvec.tolist()]))
        lines.append(f"{place}{source.names[i]},{numbers}{extra}")
    return lines


def write_parts(source):
    lines = ["session,tx,ty,tz,rx,ry,rz"]
    for name, T in part_poses().items():
        rotvec = Rotation.from_matrix(T[:3, :3]).as_rotvec()
        lines.append(f"{name},{','.join(map(repr, [*T[:3, 3].tolist(), *rotvec.tolist()]))}")
    (source.path / "sessions.csv").write_text("\n".join(lines))


SESSIONS = FolderOptions(session="sessions.csv", rotation="ur", reference_index=2)
HEADER = "name,tx,ty,tz,rx,ry,rz"


@pytest.mark.parametrize("how", ["a column", "folders in one table", "a table a session"])
def test_recordings_of_a_part_that_was_moved_join(pose_folder, how):
    write_parts(pose_folder)
    days = {"monday": range(3), "tuesday": range(3, 6)}
    names = list(pose_folder.names)
    if how == "a column":
        rows = [
            line
            for day in days
            for line in write_session(pose_folder, "", day, days[day], f",{day}")
        ]
        (pose_folder.path / "poses.csv").write_text("\n".join([f"{HEADER},session", *rows]))
    else:
        for day, rows in days.items():
            for i in rows:
                pose_folder.write_image(f"{day}/{names[i]}", pose_folder.images[i])
        names = [f"{day}/{names[i]}" for day, rows in days.items() for i in rows]
    if how == "folders in one table":
        rows = [
            line for day in days for line in write_session(pose_folder, f"{day}/", day, days[day])
        ]
        (pose_folder.path / "poses.csv").write_text("\n".join([HEADER, *rows]))
    elif how == "a table a session":
        for day, rows in days.items():
            lines = [HEADER, *write_session(pose_folder, "", day, rows)]
            (pose_folder.path / day / "poses.csv").write_text("\n".join(lines))
    data = read_folder(pose_folder.path, SESSIONS)
    assert data.names == names
    np.testing.assert_allclose(data.T_world_cam, pose_folder.T_world_cam, atol=1e-12)
    np.testing.assert_array_equal(data.images, pose_folder.images)


def test_times_of_sessions_that_began_anew_follow_each_other(pose_folder):
    write_parts(pose_folder)
    rows = [
        f"{line},{i % 3}"
        for day, days in (("monday", range(3)), ("tuesday", range(3, 6)))
        for i, line in enumerate(write_session(pose_folder, "", day, days, f",{day}"))
    ]
    (pose_folder.path / "poses.csv").write_text("\n".join([f"{HEADER},session,time", *rows]))
    data = read_folder(pose_folder.path, SESSIONS)
    assert data.times.tolist() == [0, 1, 2, 3, 4, 5]


def test_a_session_without_a_part_pose_is_refused(pose_folder):
    write_parts(pose_folder)
    rows = write_session(pose_folder, "", "monday", range(6), ",sunday")
    (pose_folder.path / "poses.csv").write_text("\n".join([f"{HEADER},session", *rows]))
    with pytest.raises(DataSetError, match=r"line 2: the session of 00.png is 'sunday', but"):
        read_folder(pose_folder.path, SESSIONS)
    (pose_folder.path / "sessions.csv").unlink()
    with pytest.raises(DataSetError, match=r"sessions.csv is missing"):
        read_folder(pose_folder.path, SESSIONS)


def test_a_column_that_seems_to_name_the_images_is_not_passed_over(pose_folder):
    write(pose_folder, "robot.txt", "ur")
    path = pose_folder.path / "robot.txt"
    path.write_text(path.read_text().replace("file,", "Bild,"))
    with pytest.raises(
        DataSetError, match=r"line 2: column 1 seems to name the images \('00.png'\)"
    ):
        read_folder(pose_folder.path, options("ur"))
    assert len(read_folder(pose_folder.path, options("ur", name_column="Bild"))) == 6


def test_a_comment_is_a_header_only_if_it_names_all_columns(pose_folder):
    write(pose_folder, "robot.txt", "wxyz", delimiter=" ")
    path = pose_folder.path / "robot.txt"
    header, *rows = path.read_text().splitlines()
    path.write_text("\n".join(["# poses of the arm, a first try", f"# {header}", *rows]))
    data = read_folder(pose_folder.path, options("xyzw"))
    np.testing.assert_allclose(data.T_world_cam, pose_folder.T_world_cam, atol=1e-12)


# Options, and the command line


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"delimiter": "::"}, "delimiter must be one of comma, semicolon"),
        ({"poses": "*/*.txt"}, "poses must have one"),
        ({"decimal": "dot"}, "decimal must be one of point, comma"),
        ({"angle_unit": "grad"}, "angle_unit must be one of deg, rad, got 'grad'"),
        ({"units": "cm"}, "units must be one of m, mm, got 'cm'"),
    ],
)
def test_a_wrong_option_is_refused(wrong, message):
    with pytest.raises(InvalidInputError, match=message):
        FolderOptions(**wrong)


def test_the_command_reads_what_its_help_shows(pose_folder, tmp_path, capsys):
    write(pose_folder, "robot.txt", "kuka-abc", mm=True)
    command = ["import", "folder", str(pose_folder.path), str(tmp_path / "set"), "--json"]
    command += ["--poses", "robot.txt", "--rotation", "kuka-abc", "--reference", "02.png"]
    assert main(command) == 0
    assert json.loads(capsys.readouterr().out)["images"] == 6
    loaded = PoseImageSet.load(tmp_path / "set")
    np.testing.assert_allclose(loaded.T_world_cam, pose_folder.T_world_cam, atol=1e-9)
    with pytest.raises(SystemExit):
        main(["import", "folder", "--help"])
    shown = capsys.readouterr().out
    assert "servoscope import folder SRC OUT --poses robot.txt --rotation kuka-abc" in shown
    for name in ("abb-quaternion", "fanuc-wpr", "ros-rpy"):
        assert name in shown


junk = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=60)


@settings(
    max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None
)
@given(
    lines=st.lists(
        st.one_of(junk, st.just("01.png,0,0,0,0,0,0"), st.just("a b c 1 2 3")), max_size=5
    ),
    rotation=st.sampled_from([None, "ur", "matrix", "kawasaki-oat"]),
)
def test_any_text_is_read_or_refused_in_one_line(pose_folder, lines, rotation):
    (pose_folder.path / "robot.txt").write_text("\n".join(lines), encoding="utf-8")
    try:
        read_folder(pose_folder.path, FolderOptions(poses="robot.txt", rotation=rotation))
    except DataSetError as error:
        assert "\n" not in str(error)  # noqa: PT017


def test_real_tables_of_matrices_are_read():
    if not DATA.is_dir():
        pytest.skip(f"no real recordings in {DATA}")
    asked = FolderOptions(
        rotation="matrix", poses="RobotPosesVec.txt", image_width=64, pivot_mm=600
    )
    board = read_folder(DATA / "kuka_board", asked)
    assert (len(board), board.names[0], board.names[-1]) == (28, "im_01.jpg", "im_28.jpg")
    np.testing.assert_allclose(
        board.T_world_cam[0, :3, 3], [-0.567412354, 1.129812866, 0.606329834]
    )
