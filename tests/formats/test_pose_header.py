import pytest

from servoscope.errors import DataSetError
from servoscope.formats import TumOptions, read_tum
from servoscope.formats.pose_header import check_pose_header

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
