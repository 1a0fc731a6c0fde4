"""``servoscope import`` and ``servoscope info`` of images that somebody else took."""

import json
import os

import numpy as np
import pytest

from servoscope.cli import main
from servoscope.data.images import PoseImageSet

pytestmark = pytest.mark.filterwarnings("default::servoscope.errors.ServoscopeWarning")

COUNTS = {"black": 1, "saturated": 0, "flat": 0, "repeated": 1}


@pytest.fixture
def spoilt(pose_folder):
    pose_folder.write_image("01.png", np.zeros((12, 16), np.uint8))
    pose_folder.write_image("04.png", pose_folder.images[3])
    pose_folder.write_csv()
    return pose_folder.path


def test_import_and_info_count_and_name_what_shows_nothing(spoilt, tmp_path, capsys):
    assert main(["import", "folder", str(spoilt), str(tmp_path / "set"), "--json"]) == 0
    imported = capsys.readouterr()
    assert "of 6 images 1 black (01.png), 1 repeated (04.png)" in imported.err
    assert main(["info", str(tmp_path / "set"), "--json"]) == 0
    for out in (imported.out, capsys.readouterr().out):
        facts = json.loads(out)
        assert facts["unusable_images"] == COUNTS
        assert "1 black (01.png), 1 repeated (04.png)" in facts["warnings"][0]


def test_what_shows_nothing_is_left_out_when_asked(spoilt, tmp_path, capsys):
    command = ["import", "folder", str(spoilt), str(tmp_path / "set"), "--skip-bad", "--json"]
    assert main(command) == 0
    out, err = capsys.readouterr()
    assert "4 frames kept; left out: 1 black (01.png), 1 repeated (04.png)" in err
    facts = json.loads(out)
    assert facts["images"] == 4
    assert facts["unusable_images"] == dict.fromkeys(COUNTS, 0)
    assert facts["warnings"] == []


@pytest.mark.parametrize("part", ["acquisition.json", "meta.json", "poses.csv", "reference.png"])
def test_info_of_a_folder_with_pipes_ends_in_one_line(pose_folder, tmp_path, capsys, part):
    pose_folder.write_csv()
    assert main(["import", "folder", str(pose_folder.path), str(tmp_path / "set")]) == 0
    (tmp_path / "set" / part).unlink(missing_ok=True)
    os.mkfifo(tmp_path / "set" / part)
    capsys.readouterr()
    assert main(["info", str(tmp_path / "set")]) == 1
    err = capsys.readouterr().err
    assert len(err.splitlines()) == 1
    assert f"{part} must be a file, but is a pipe" in err


@pytest.mark.parametrize(
    "content",
    [
        *("[]", "{}", '{"plan": []}', '{"plan": {}, "n_done": -1}', "\\", ""),
        '{"plan": {}, "n_done": "7"}',
        '{"plan": {}, "n_done": 1' + "0" * 400 + "}",
    ],
)
def test_a_broken_acquisition_is_one_line_and_no_obstacle_to_force(
    pose_folder, tmp_path, capsys, content
):
    pose_folder.write_csv()
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "acquisition.json").write_text(content)
    assert main(["info", str(tmp_path / "set")]) == 1
    err = capsys.readouterr().err
    assert len(err.splitlines()) == 1
    assert "acquisition.json" in err
    command = ["import", "folder", str(pose_folder.path), str(tmp_path / "set")]
    assert main(command) == 1
    assert "replace it with --force" in capsys.readouterr().err
    assert main([*command, "--force"]) == 0


def test_the_dofs_of_the_robot_are_kept_with_the_images(pose_folder, tmp_path, capsys):
    pose_folder.write_csv()
    command = ["import", "folder", str(pose_folder.path), str(tmp_path / "set"), "--json"]
    assert main([*command, "--dofs", "rz,tx"]) == 0
    assert json.loads(capsys.readouterr().out)["dofs"] == ["tx", "rz"]
    assert PoseImageSet.load(tmp_path / "set").dofs == ("tx", "rz")
    assert main([*command, "--dofs", "rz,rz", "--force"]) == 1
    assert "each named once, got rz,rz" in capsys.readouterr().err
