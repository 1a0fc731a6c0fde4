"""Trajectories are read back by other readers of their formats."""

import csv
import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from planar import planar_data_set
from planar_cell import Cell, Oracle
from servoscope.cli import main
from servoscope.errors import InvalidInputError
from servoscope.export.trajectory import (
    TimedPoses,
    as_text,
    poses_of_data,
    poses_of_log,
    write_trajectory,
)
from servoscope.formats import TumOptions, read_tum
from servoscope.positioning import Positioner
from servoscope.positioning.run_log import RunLog, read_steps


@pytest.fixture(scope="module")
def data():
    return replace(planar_data_set(n_images=6), times=1_305_031_102.1758 + np.arange(6) / 30)


def read_kitti(text):
    """As evo does: 12 numbers in a row."""
    rows = np.array([line.split(" ") for line in text.splitlines()], float)
    assert rows.shape[1] == 12
    last = np.tile([[[0.0, 0.0, 0.0, 1.0]]], (len(rows), 1, 1))
    return np.concatenate([rows.reshape(-1, 3, 4), last], axis=1)


def test_our_own_importer_reads_what_is_written_for_tum(data, tmp_path):
    (tmp_path / "rgb").mkdir()
    lines = []
    for k, (time, image) in enumerate(zip(data.times, data.images, strict=True)):
        cv2.imwrite(str(tmp_path / "rgb" / f"{k}.png"), image)
        lines.append(f"{time:.6f} rgb/{k}.png")
    (tmp_path / "rgb.txt").write_text("\n".join(lines))
    write_trajectory(tmp_path / "groundtruth.txt", poses_of_data(data), "tum")
    read = read_tum(tmp_path, TumOptions(reference_index=2))
    np.testing.assert_array_equal(read.images, data.images)
    np.testing.assert_allclose(read.T_world_cam, data.T_world_cam, atol=2e-9)
    np.testing.assert_allclose(read.times, data.times, atol=1e-6)


def test_tum_is_eight_columns_with_unit_quaternions(data):
    rows = csv.reader(as_text(poses_of_data(data), "tum").splitlines(), delimiter=" ")
    numbers = np.array([row for row in rows if not row[0].startswith("#")], float)
    assert numbers.shape == (6, 8)
    np.testing.assert_allclose(np.linalg.norm(numbers[:, 4:], axis=1), 1, atol=1e-11)
    np.testing.assert_allclose(numbers[:, 1:4], data.T_world_cam[:, :3, 3], atol=1e-9)


def test_kitti_is_the_upper_three_rows(data):
    read = read_kitti(as_text(poses_of_data(data), "kitti"))
    np.testing.assert_allclose(read, data.T_world_cam, atol=1e-11)


def test_images_without_times_are_numbered(data):
    poses = poses_of_data(replace(data, times=None))
    np.testing.assert_array_equal(poses.times, range(6))
    assert not poses.is_timed


def test_an_unknown_format_is_refused():
    with pytest.raises(InvalidInputError, match="tum or kitti"):
        as_text(TimedPoses(np.eye(4)[None], np.zeros(1), True), "bvh")


@pytest.fixture
def log(tmp_path):
    cell = Cell(np.array([0.01, 0.0, -0.01, 0.05, 0.0, 0.1]))
    positioner = Positioner(Oracle(cell, std=1e-4))
    log = RunLog(tmp_path / "log", positioner)
    log.finish(positioner.run(cell, cell, on_step=log.write))
    return tmp_path / "log"


def test_the_poses_of_a_log_are_those_it_looked_at(log):
    poses = poses_of_log(log)
    expected = [step.pose for step, _ in read_steps(log)]
    np.testing.assert_array_equal(poses.T_world_cam, expected)


def test_a_log_without_a_look_is_refused(tmp_path):
    RunLog(tmp_path / "log", Positioner(Oracle(Cell(np.zeros(6)))))
    with pytest.raises(InvalidInputError, match="no look"):
        poses_of_log(tmp_path / "log")


def test_the_command_takes_logs_and_data_sets(log, data, tmp_path, capsys):
    file = tmp_path / "poses.txt"
    assert main(["export", str(log), str(file), "--format", "kitti", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["poses"] == len(read_kitti(file.read_text()))
    data.save(tmp_path / "set")
    assert main(["export", str(tmp_path / "set"), str(file)]) == 1
    assert "--force" in capsys.readouterr().err
    assert main(["export", str(tmp_path / "set"), str(file), "--force", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["stamps"] == "as recorded"
    assert file.read_text() == as_text(poses_of_data(data), "tum")
    assert main(["export", str(tmp_path), str(file), "--force"]) == 1
    assert len(capsys.readouterr().err.splitlines()) == 1
