"""Assessing, training and positioning from the command line, on small images of the part."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from servoscope.cli import main
from servoscope.commands.cells import Cell, CellOptions
from servoscope.data.images import PoseImageSet
from servoscope.poses import (
    DISPLAY_FACTORS,
    DOFS,
    displacements_from_poses,
    inverse_transform,
    rigid_transform,
)
from servoscope.positioning import LoopSettings, PositioningModel
from servoscope.robots.free_camera import FreeCamera
from servoscope.robots.registry import ROBOTS
from servoscope.scene.scene import T_WORLD_REF
from servoscope.storage.model_folder import read_model
from servoscope.wording import plain_number
from small_keyframe import quick_fits, small_model


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    """A folder with a data set, its assessment, and a model that was trained on both."""
    folder = tmp_path_factory.mktemp("cell")
    data, run, model = (str(folder / name) for name in ("data", "run", "model"))
    assert main(["acquire", data, "--image-size", "64", "--schedule", "60@1.6", "--jobs", "1"]) == 0
    with quick_fits():
        assert main(["assess", data, "--out", run, "--families", "moments", "--jobs", "1"]) == 0
        assert main(["train", data, "--assessment", run, "--out", model, "--jobs", "1"]) == 0
    return folder


def run(capsys, *arguments):
    code = main([*map(str, arguments)])
    said = capsys.readouterr()
    return code, said.out, said.err


def test_a_model_holds_what_it_was_trained_on_and_reaches(cell, capsys) -> None:
    code, out, _ = run(capsys, "info", cell / "model", "--json")
    facts = json.loads(out)
    assert code == 0
    assert facts["trained_on"]["part"] == "cylinder_head"
    assert facts["kind"] == "keyframe"
    assert facts["accuracy"]["rms"]["tz"] < 2


def test_training_does_not_replace_a_model_unasked(cell, capsys) -> None:
    code, _, err = run(capsys, "train", cell / "data", "--out", cell / "model")
    assert code == 1
    assert len(err.splitlines()) == 1


def test_the_camera_comes_back(cell, capsys) -> None:
    code, out, _ = run(capsys, "position", cell / "model", "--seed", 1, "--json")
    result = json.loads(out)
    assert (code, result["status"]) == (0, "converged")
    assert result["true_error"]["mm"] < 1
    assert result["true_error"]["deg"] < 0.1
    again = json.loads(run(capsys, "position", cell / "model", "--seed", 1, "--json")[1])
    assert again["true_error"] == result["true_error"]
    assert again["steps"][-1]["pose"] == result["steps"][-1]["pose"]


@pytest.mark.parametrize("option", ["--dry-run", "--preview"])
def test_a_dry_run_tells_the_move_and_does_not_make_it(cell, capsys, option) -> None:
    code, out, _ = run(capsys, "position", cell / "model", option, "--json")
    result = json.loads(out)
    assert code == 0
    assert result["moves"] == 0
    assert result["true_error"]["mm"] > 10
    assert "nothing was moved" in result["message"]


def test_a_run_is_logged_and_replayed(cell, capsys, tmp_path) -> None:
    log = tmp_path / "log"
    assert run(capsys, "position", cell / "model", "--log", log)[0] == 0
    code, out, _ = run(capsys, "position", cell / "model", "--replay", log, "--json")
    looks = json.loads(out)["looks"]
    assert code == 0
    assert len(looks) > 2
    assert not any(look["differs"] for look in looks)
    assert run(capsys, "position", cell / "model", "--log", log)[0] == 1


def test_people_are_shown_every_look(cell, capsys) -> None:
    code, out, _ = run(capsys, "position", cell / "model", "--condition", "gain_0.8")
    assert code == 0
    for words in (
        "answered by",
        "predicted error about the pivot: tx",
        "true error about the pivot: tx",
        "true error of the camera:",
        "converged:",
    ):
        assert words in out


def test_true_displacements_are_of_the_frame_that_the_robot_reports(rng):
    T_ref, T_now, mount = rigid_transform(
        Rotation.random(3, rng=rng).as_matrix(), rng.normal(size=(3, 3))
    )
    robot = SimpleNamespace(true_pose=T_now @ mount)
    cell = Cell(robot, robot, LoopSettings(), T_ref @ mount, mount)
    np.testing.assert_allclose(cell.true_displacement(), np.linalg.inv(T_ref) @ T_now, atol=1e-12)
    carried = cell._replace(T_reported_cam=None)
    np.testing.assert_allclose(
        carried.true_displacement(), np.linalg.inv(T_ref @ mount) @ T_now @ mount, atol=1e-12
    )


class Hook(FreeCamera):
    """Carries its camera 3 cm aside of the frame that it reports, and turned."""

    MOUNT = rigid_transform(Rotation.from_euler("z", 0.4).as_matrix(), [0.03, 0.0, 0.05])

    @property
    def pose(self):
        return super().pose @ inverse_transform(self.MOUNT)


def test_the_truth_of_any_simulated_robot_is_of_the_frame_that_it_reports(monkeypatch):
    monkeypatch.setitem(ROBOTS.built_in, "hook", Hook)
    source = {"part": "textured_plane", "variant": 0, "robot": "hook"}
    model = replace(small_model(guesses=False), trained_on=source)
    with CellOptions(start="3").opened(model, LoopSettings()) as cell:
        expected = Hook.MOUNT @ inverse_transform(T_WORLD_REF) @ cell.robot.pose
        np.testing.assert_allclose(cell.true_displacement(), expected, atol=1e-3)


def test_what_does_not_converge_fails_with_its_status(cell, capsys) -> None:
    code, out, err = run(capsys, "position", cell / "model", "--max-moves", 0)
    assert code == 1
    assert err.startswith("servoscope: max_moves: ")
    assert len(err.splitlines()) == 1
    assert "true error" in out


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--robot", "arm"], "trained with --robot free"),
        (["--condition", "dark"], "must be one of range_0.4"),
        (["--max-moves", "-1"], "max_moves"),
        (["--tolerance-mm", "nan"], "tolerance_mm"),
    ],
)
def test_bad_options_are_told_in_a_line(cell, capsys, options, said) -> None:
    code, _, err = run(capsys, "position", cell / "model", *options)
    assert code == 1
    assert said in err
    assert len(err.splitlines()) == 1


@pytest.mark.parametrize("robot", ["legs", "", "Free", "recorded", "recorded:"])
def test_a_robot_that_is_none_is_refused_whatever_the_model(capsys, tmp_path, robot) -> None:
    code, _, err = run(capsys, "position", tmp_path, "--robot", robot)
    assert code == 1
    assert "--robot must be free, arm, ur:HOST, " in err
    assert f"recorded:FOLDER or module:Class of your own, got {robot!r}" in err
    assert len(err.splitlines()) == 1


def test_a_model_of_other_images_moves_no_simulated_robot(cell, capsys, tmp_path) -> None:
    model = PositioningModel.load(cell / "model")
    model.trained_on.clear()
    model.save(tmp_path / "own")
    code, _, err = run(capsys, "position", tmp_path / "own")
    assert code == 1
    assert "robot of your own" in err


def test_images_that_cannot_train_are_refused_in_a_line(cell, capsys, tmp_path) -> None:
    data = PoseImageSet.load(cell / "data")
    few = PoseImageSet(
        data.images[:9],
        data.T_world_cam[:9],
        data.T_world_ref,
        data.reference_image,
        pivot=data.pivot,
        pivot_ranges=data.pivot_ranges,
    )
    few.save(tmp_path / "few")
    code, _, err = run(capsys, "train", tmp_path / "few", "--out", tmp_path / "model")
    assert code == 1
    assert "at least" in err
    assert len(err.splitlines()) == 1
    assert not (tmp_path / "model").exists()


def test_the_loop_runs_on_recorded_images(cell, capsys) -> None:
    robot = ["--robot", f"recorded:{cell / 'data'}"]
    code, out, _ = run(capsys, "position", cell / "model", *robot, "--seed", 2, "--json")
    result = json.loads(out)
    assert (code, result["status"]) == (0, "converged"), result["message"]
    assert result["true_error"]["mm"] < 2
    name = PoseImageSet.load(cell / "data").names[7]
    by = [
        run(capsys, "position", cell / "model", *robot, "--start", x, "--json") for x in (7, name)
    ]
    assert json.loads(by[0][1])["steps"][0]["pose"] == json.loads(by[1][1])["steps"][0]["pose"]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--robot", "recorded:{data}", "--condition", "gain_0.8"], "leave it out"),
        (["--robot", "recorded:{data}", "--start", "nobody"], "number or the name"),
        (["--robot", "recorded:{data}", "--start", "99999"], "frame from 0 to 60"),
        (["--robot", "recorded:{data}/nowhere"], "nowhere"),
        (["--robot", "recorded:{other}"], "is not the one that the model was trained on"),
        (["--start", "x"], "number from 0"),
    ],
)
def test_bad_recordings_are_refused_in_a_line(cell, capsys, tmp_path, options, said) -> None:
    data = PoseImageSet.load(cell / "data")
    other = replace(data, reference_image=data.reference_image[::-1])
    other.save(tmp_path / "other")
    options = [x.format(data=cell / "data", other=tmp_path / "other") for x in options]
    code, _, err = run(capsys, "position", cell / "model", *options)
    assert code == 1
    assert said in err
    assert len(err.splitlines()) == 1


def rows_of(table: str) -> dict[str, list[str]]:
    """The cells of a printed table by dof."""
    lines = [line.split("│")[1:-1] for line in table.splitlines() if line.startswith("│")]
    return {cells[0].strip(): [cell.strip() for cell in cells[1:]] for cells in lines}


@pytest.mark.slow
def test_what_is_read_of_one_part_agrees_from_assessing_to_positioning(cell, capsys):
    written = json.loads((cell / "run" / "assessment.json").read_text())
    accuracy = read_model(cell / "model")[0]["accuracy"]
    capsys.readouterr()
    assert main(["info", str(cell / "model")]) == 0
    out = capsys.readouterr().out
    assert max(map(len, out.splitlines())) <= 80
    rows = rows_of(out)
    assert list(rows) == list(DOFS)
    for dof, row in written["dofs"].items():
        assert row["one_look"]["by"] == "keyframe"
        assert accuracy["rms"][dof] == pytest.approx(row["one_look"]["rms"], rel=1e-9)
        shown = (row["forecast_rms"], row["reached_rms"], row["one_look"]["rms"])
        shown = (*shown, row["loop"]["end_rms"])
        assert rows[dof][:4] == [f"{plain_number(value)} {row['unit']}" for value in shown]
    assert accuracy["held_out"]["images"] == written["keyframe"]["n_read"]
    ends = []
    for seed in (1, 2, 3):
        assert main(["position", str(cell / "model"), "--seed", str(seed), "--json"]) == 0
        ends.append(json.loads(capsys.readouterr().out)["true_error"])
    for unit in ("mm", "deg"):
        ratio = np.median([end[unit] for end in ends]) / written["loop"][f"end_{unit}"]
        assert 1 / 3 < ratio < 3


def test_a_person_is_told_the_way_back_in_the_axes_of_the_camera(cell, capsys) -> None:
    data = PoseImageSet.load(cell / "data")
    camera = ["--camera", f"recorded:{cell / 'data'}", "--once", "--json"]
    code, out, _ = run(capsys, "aim", cell / "model", *camera)
    facts = json.loads(out)
    way_back = inverse_transform(inverse_transform(data.T_world_ref) @ data.T_world_cam[0])
    expected = DISPLAY_FACTORS * displacements_from_poses(np.eye(4), way_back[None], 0.0)[0]
    found = np.array([facts["correction"][dof]["value"] for dof in DOFS])
    assert (code, facts["status"], facts["axes"]) == (0, "move", "camera")
    for part in (slice(3), slice(3, 6)):  # the axes are those of a mount that was fitted
        missed = np.linalg.norm(found[part] - expected[part])
        assert missed < 0.1 * np.linalg.norm(expected[part])
