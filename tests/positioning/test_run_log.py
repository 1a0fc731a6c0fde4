"""A log holds every look of a run, survives being cut short, and is read with care."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from planar import RANGES
from planar_cell import Cell, Oracle
from servoscope.errors import FolderExistsError, InvalidInputError, RunFolderError
from servoscope.positioning.interfaces import Estimate
from servoscope.positioning.look_and_move import Positioner
from servoscope.positioning.run_log import RunLog, read_steps, replay

START = 0.5 * RANGES * [1, -1, 1, -1, 1, 1]


class FromBrightness(Oracle):
    """Tells, of the image alone, its mean as tx; the second look and those after it are fine."""

    factor = 3e-3

    def estimate(self, image, previous):
        tx = self.factor * (float(image.mean()) - float(self.reference_image.mean()))
        T = np.eye(4)
        T[0, 3] = tx
        return Estimate(T, self.std, 0.5, "coarse" if previous is None else "fine")


@pytest.fixture
def log(tmp_path: Path):
    cell = Cell(START)
    positioner = Positioner(FromBrightness(cell, std=0.01))
    run_log = RunLog(tmp_path / "log", positioner)
    result = positioner.run(cell, cell, on_step=run_log.write)
    run_log.finish(result)
    return run_log.path, result


def test_the_log_gives_back_what_was_seen_and_decided(log) -> None:
    path, result = log
    read = list(read_steps(path))
    assert len(read) == len(result.steps) > 1
    for (step, image), logged in zip(read, result.steps, strict=True):
        for name in ("pose", "commanded", "image_error", "seconds"):
            np.testing.assert_array_equal(getattr(step, name), getattr(logged, name))
        np.testing.assert_array_equal(step.estimate.displacement, logged.estimate.displacement)
        np.testing.assert_array_equal(step.estimate.std, logged.estimate.std)
        assert (step.estimate.stage, step.estimate.novelty) == (logged.estimate.stage, 0.5)
        cell = Cell(START)
        cell.poses[-1] = step.pose
        np.testing.assert_array_equal(image, cell.read())
    assert json.loads((path / "result.json").read_text()) == result.to_dict()


def test_replay_finds_no_difference_in_the_same_estimator_and_tells_that_of_another(log) -> None:
    path, result = log
    oracle = FromBrightness(Cell(START), std=0.01)
    replayed = replay(path, oracle)
    assert len(replayed) == len(result.steps)
    assert not any(look.differs for look in replayed)
    oracle.factor *= 2
    other = replay(path, oracle)
    assert other[0].differs
    expected = abs(result.steps[0].estimate.displacement[0, 3])
    assert other[0].distance == pytest.approx(expected)
    assert other[0].angle == 0


def test_replay_tells_another_stage(log, monkeypatch) -> None:
    path, _ = log
    oracle = FromBrightness(Cell(START), std=0.01)
    first = oracle.estimate
    monkeypatch.setattr(oracle, "estimate", lambda image, previous: first(image, None))
    assert [look.differs for look in replay(path, oracle)][:2] == [False, True]


def test_a_line_cut_short_is_left_out_and_the_rest_is_read(log) -> None:
    path, result = log
    content = (path / "steps.jsonl").read_bytes()
    (path / "steps.jsonl").write_bytes(content[:-20])
    assert len(list(read_steps(path))) == len(result.steps) - 1


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda p: _edit(p / "steps.jsonl", "{", "(", 1), "Line 1 of .* is damaged"),
        (lambda p: _edit(p / "steps.jsonl", '"std"', '"sdt"'), "damaged .*std"),
        (lambda p: _edit(p / "steps.jsonl", '"std": [', '"std": [0.0, '), r"shape \(6,\), got"),
        (lambda p: _edit(p / "steps.jsonl", '"pose": [[', '"pose": [["x", '), "damaged"),
        (lambda p: (p / "steps.jsonl").write_text("[1]\n"), "damaged"),
        (lambda p: (p / "steps.jsonl").write_bytes(b"\xff\xfe\n"), "damaged"),
        (lambda p: (p / "steps.jsonl").write_text("[" * 100_000 + "\n"), "damaged"),
        (lambda p: (p / "images/001.png").unlink(), "Line 2 .*001.png is no image"),
        (lambda p: (p / "images/000.png").write_bytes(b"\x89PNG nothing"), "000.png is no image"),
        (lambda p: _edit(p / "run.json", '"version": 1', '"version": 2'), "log of version 2"),
        (lambda p: (p / "run.json").unlink(), "run.json is missing"),
    ],
)
def test_a_damaged_log_is_told_in_one_line(log, damage, message: str) -> None:
    path, _ = log
    damage(path)
    with pytest.raises(RunFolderError, match=message) as caught:
        replay(path, FromBrightness(Cell(START)))
    assert "\n" not in str(caught.value)


def test_an_estimator_of_another_size_cannot_replay(log) -> None:
    oracle = FromBrightness(Cell(START))
    oracle.image_shape = (32, 40)
    with pytest.raises(InvalidInputError, match="48 x 48, but it takes 40 x 32"):
        replay(log[0], oracle)


def test_a_folder_with_anything_in_it_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(FolderExistsError, match="there already"):
        RunLog(tmp_path, Positioner(Oracle(Cell(START))))
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs SIGKILL")
def test_a_run_that_is_killed_in_a_move_has_its_looks_on_disk(tmp_path: Path) -> None:
    script = f"""
import os, signal, sys
sys.path.insert(0, {str(Path(__file__).parents[1])!r})
from planar_cell import Cell, Oracle
from planar import RANGES
from servoscope.positioning.look_and_move import Positioner
from servoscope.positioning.run_log import RunLog
cell = Cell(0.5 * RANGES)
move = cell.move
cell.move = lambda D: move(D) if len(cell.poses) < 3 else os.kill(os.getpid(), signal.SIGKILL)
positioner = Positioner(Oracle(cell, lambda p: 0.7 * p))
positioner.run(cell, cell, on_step=RunLog({str(tmp_path / "log")!r}, positioner).write)
"""
    killed = subprocess.run([sys.executable, "-c", script], env=dict(os.environ))
    assert killed.returncode == -signal.SIGKILL
    steps = [step for step, _ in read_steps(tmp_path / "log")]
    assert len(steps) == 3
    assert all(step.commanded is not None for step in steps)


def _edit(path: Path, old: str, new: str, count: int = -1) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, count))
