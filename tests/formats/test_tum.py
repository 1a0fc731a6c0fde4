import warnings
from pathlib import Path

import numpy as np
import pytest

from servoscope.errors import DataSetError, ServoscopeWarning
from servoscope.formats import TumOptions, read_tum

DESK = Path(__file__).parents[3] / "shared" / "data" / "tum_fr1_rpy"
NAMED = TumOptions(reference="02.png")


def refusal(source, options=NAMED):
    """The one line that refuses a sequence."""
    with pytest.raises(DataSetError) as caught:
        read_tum(source.path, options)
    message = str(caught.value)
    assert "\n" not in message
    assert str(source.path) in message
    return message


def test_images_get_the_pose_of_their_time(pose_folder):
    pose_folder.write_tum()
    data = read_tum(pose_folder.path, NAMED)
    np.testing.assert_array_equal(data.images, pose_folder.images)
    np.testing.assert_allclose(data.T_world_cam, pose_folder.T_world_cam, atol=1e-9)
    np.testing.assert_allclose(data.times, pose_folder.times, atol=1e-6)
    assert data.names == pose_folder.names
    assert data.split == "blocks"
    assert data.source["format"] == "tum"


def test_unsorted_poses_give_the_same_set(pose_folder):
    order = [3, 0, 5, 1, 4, 2]
    pose_folder.write_tum(pose_folder.times[order], pose_folder.numbers[order])
    data = read_tum(pose_folder.path, NAMED)
    np.testing.assert_allclose(data.T_world_cam, pose_folder.T_world_cam, atol=1e-9)


def test_images_between_poses_get_interpolated_or_nearest_poses(pose_folder):
    pose_folder.write_tum(image_times=pose_folder.times + 0.02)
    options = {"reference": "02.png", "max_gap_s": 0.03}
    data = read_tum(pose_folder.path, TumOptions(**options))
    np.testing.assert_allclose(
        data.T_world_cam[:, 0, 3], [0.002, 0.012, 0.022, 0.032, 0.042, 0.05], atol=1e-6
    )
    data = read_tum(pose_folder.path, TumOptions(pairing="nearest", **options))
    np.testing.assert_allclose(data.T_world_cam, pose_folder.T_world_cam, atol=1e-9)


def test_images_without_a_pose_near_in_time_are_left_out_and_counted(pose_folder):
    times = pose_folder.times + np.array([0, 0.019, -0.019, 0.021, -0.021, 0])
    pose_folder.write_tum(image_times=times)
    pattern = r"4 frames kept; left out: 2 without a pose near in time \(03.png, 04.png\)"
    with pytest.warns(ServoscopeWarning, match=pattern):
        data = read_tum(pose_folder.path, NAMED)
    assert data.names == ["00.png", "01.png", "02.png", "05.png"]
    assert data.source["dropped"] == {"without a pose near in time": 2}


def test_no_image_near_a_pose_is_refused_with_the_least_gap(pose_folder):
    pose_folder.write_tum(image_times=pose_folder.times + 1000)
    message = refusal(pose_folder)
    assert "within 0.02 s (the least gap is 999.5 s)" in message


def test_scalar_first_quaternions_are_read_when_said_so(pose_folder):
    pose_folder.write_tum(numbers=pose_folder.numbers[:, [0, 1, 2, 6, 3, 4, 5]])
    data = read_tum(pose_folder.path, TumOptions(reference="02.png", quaternion_order="wxyz"))
    np.testing.assert_allclose(data.T_world_cam, pose_folder.T_world_cam, atol=1e-9)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("100.31 0 0 nan 0 0 0 1", "line 5: tz must be a finite number, got 'nan'"),
        ("100.31 0 0 0 0 0 0 0", "line 5: the quaternion"),
        ("100.31 0 0 0 0 0 1", "line 5: must be 'timestamp tx ty tz qx qy qz qw', got"),
        ("when 0 0 0 0 0 0 1", "line 5: timestamp must be a finite number, got 'when'"),
    ],
)
def test_an_unusable_pose_is_refused_by_line_or_skipped_and_counted(pose_folder, line, message):
    pose_folder.write_tum()
    path = pose_folder.path / "groundtruth.txt"
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:4], line, *lines[4:]]))
    assert message in refusal(pose_folder)
    pattern = r"1 with an unusable pose \(groundtruth.txt, line 5\)"
    with pytest.warns(ServoscopeWarning, match=pattern):
        data = read_tum(pose_folder.path, TumOptions(reference="02.png", skip_bad=True))
    assert len(data) == 6


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("rgb.txt", "# nothing\n", "rgb.txt names no image"),
        ("rgb.txt", "100.0\n", "line 1: must be 'timestamp filename', got '100.0'"),
        ("rgb.txt", "soon 00.png\n", "line 1: timestamp must be a finite number"),
        ("rgb.txt", "1 ../x.png\n", "line 1: '../x.png' leads out of the folder"),
        ("rgb.txt", "1 00.png\n2 00.png\n", "rgb.txt names 00.png more than once"),
        ("rgb.txt", "100.000 00.png\n", "1 image with a pose"),
        ("groundtruth.txt", "# nothing\n", "groundtruth.txt holds no pose"),
    ],
)
def test_an_unusable_list_is_refused(pose_folder, name, content, message):
    pose_folder.write_tum()
    (pose_folder.path / name).write_text(content)
    assert message in refusal(pose_folder, TumOptions())


@pytest.mark.parametrize("name", ["rgb.txt", "groundtruth.txt"])
def test_a_missing_list_is_refused_by_name(pose_folder, name):
    pose_folder.write_tum()
    (pose_folder.path / name).unlink()
    assert f"{name} is missing" in refusal(pose_folder)


def test_a_truncated_image_in_the_middle_is_refused_or_skipped(pose_folder):
    path = pose_folder.path / "03.png"
    path.write_bytes(path.read_bytes()[:-60])
    pose_folder.write_tum()
    assert "03.png is not a whole image" in refusal(pose_folder)
    with pytest.warns(ServoscopeWarning, match=r"1 with an unusable image \(03.png\)"):
        data = read_tum(pose_folder.path, TumOptions(reference="02.png", skip_bad=True))
    assert len(data) == 5


def test_windows_line_ends_and_byte_order_marks_are_accepted(pose_folder):
    pose_folder.write_tum()
    for name in ("rgb.txt", "groundtruth.txt"):
        path = pose_folder.path / name
        path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes().replace(b"\n", b"\r\n"))
    assert len(read_tum(pose_folder.path, NAMED)) == 6


@pytest.mark.skipif(not DESK.is_dir(), reason="the TUM sequence is not here")
@pytest.mark.parametrize(
    ("max_gap_s", "max_mm", "max_deg", "paired", "near"),
    [(0.005, 150, 20, 717, 261), (0.02, 150, 20, 720, 261), (0.005, 200, 30, 717, 407)],
)
def test_the_desk_sequence_gives_its_known_counts(max_gap_s, max_mm, max_deg, paired, near):
    options = TumOptions(
        reference_index=144, max_mm=max_mm, max_deg=max_deg, max_gap_s=max_gap_s, image_width=160
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ServoscopeWarning)
        data = read_tum(DESK, options)
    assert len(data) == near
    assert data.image_shape == (120, 160)
    assert data.source["dropped"] == {
        "without a pose near in time": 723 - paired,
        "far from the reference": paired - near,
    }
