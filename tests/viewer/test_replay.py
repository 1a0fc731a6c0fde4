"""A log is read back into a history, and gone through by the buttons."""

import json
from pathlib import Path

import numpy as np
import pytest

from planar import RANGES
from planar_cell import Cell, Oracle
from servoscope.errors import InvalidInputError, RunFolderError
from servoscope.poses import DISPLAY_FACTORS, displacements_from_poses
from servoscope.positioning.look_and_move import Positioner
from servoscope.positioning.run_log import RunLog
from servoscope.viewer.replay import Replay, read_log
from small_keyframe import small_model


@pytest.fixture
def log(tmp_path: Path):
    cell = Cell(0.5 * RANGES)
    positioner = Positioner(Oracle(cell, lambda delta_p: 0.8 * delta_p, std=0.01))
    run_log = RunLog(tmp_path / "log", positioner)
    result = positioner.run(cell, cell, on_step=run_log.write)
    run_log.finish(result)
    assert len(result.steps) > 3
    return run_log.path, result


def test_a_log_is_shown_as_it_was_believed(log) -> None:
    path, result = log
    history = read_log(path)
    assert history.end == f"{result.status}: {result.message}"
    assert len(history.looks) == len(result.steps)
    for look, step in zip(history.looks, result.steps, strict=True):
        delta_p = displacements_from_poses(
            np.eye(4), step.estimate.displacement[None], Oracle.pivot
        )
        np.testing.assert_allclose(look.displacement, DISPLAY_FACTORS * delta_p[0])
        assert (look.next_camera is None) == (step.commanded is None)
    np.testing.assert_array_equal(history.setting.reference_image, Oracle.reference_image)


def test_a_log_of_a_run_that_was_cut_short_says_so_and_shows_what_there_is(log) -> None:
    path, result = log
    (path / "result.json").unlink()
    lines = (path / "steps.jsonl").read_bytes()
    (path / "steps.jsonl").write_bytes(lines[:-20])
    history = read_log(path)
    assert "cut short" in history.end
    assert len(history.looks) == len(result.steps) - 1


def test_logs_that_cannot_be_shown_are_refused_in_one_line(log, tmp_path: Path) -> None:
    path, _ = log
    with pytest.raises(InvalidInputError, match="same reference image"):
        read_log(path, small_model(guesses=False))
    with pytest.raises(RunFolderError):
        read_log(tmp_path / "none")
    run = json.loads((path / "run.json").read_text())
    (path / "run.json").write_text(json.dumps({**run, "pivot": None}))
    with pytest.raises(RunFolderError, match="damaged"):
        read_log(path)
    (path / "run.json").write_text(json.dumps(run))
    (path / "reference.png").write_bytes(b"none")
    with pytest.raises(RunFolderError, match="no image"):
        read_log(path)


def test_a_log_without_a_look_is_refused(log) -> None:
    path, _ = log
    (path / "steps.jsonl").unlink()
    with pytest.raises(RunFolderError, match="no look"):
        read_log(path)


def test_step_shows_the_next_look_run_all_that_follow_and_stop_stays(log) -> None:
    history = read_log(log[0])
    seen: list[int] = []
    replay, last = Replay(history, seen.append), len(history.looks) - 1
    replay.tick()
    assert seen == []
    replay.step()
    replay.tick()
    assert seen == [1]
    replay.run()
    replay.tick()
    assert seen == [1, 2]
    replay.stop()
    replay.tick()
    assert seen == [1, 2]
    replay.run()
    for _ in range(last + 2):
        replay.tick()
    assert seen == list(range(1, last + 1))
    replay.step()
    assert replay.current == last
    replay.run()
    replay.tick()
    assert seen[-2:] == [0, 1]
    replay.seek(last + 9)
    assert replay.current == last
