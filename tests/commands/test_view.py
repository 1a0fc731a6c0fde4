"""``servoscope view`` of what has been."""

import signal
import sys
from pathlib import Path

import numpy as np
import pytest

from planar import RANGES
from planar_cell import Cell, Oracle
from rehearsal_sample import model as rehearsal_model
from servoscope.cli import main
from servoscope.positioning import PositioningModel
from servoscope.positioning.look_and_move import Positioner
from servoscope.positioning.run_log import RunLog
from servoscope.viewer.live import LiveRun
from servoscope.viewer.replay import read_log

pytest.importorskip("viser")

TESTS = str(Path(__file__).parents[1])

OWN = """
import sys
import numpy as np
sys.path.append({tests!r})
from rehearsal_sample import displacements, model

class Cell:
    made = []

    def __init__(self):
        self.pose, self.keyframe = displacements(1)[0], model().keyframe
        self.moves = self.stops = 0
        self.made.append(self)

    def read(self):
        return self.keyframe.render(self.pose)[0]

    def move_to(self, pose):
        self.moves, self.pose = self.moves + 1, pose

    def stop(self):
        self.stops += 1
"""


@pytest.fixture
def log(tmp_path):
    cell = Cell(0.5 * RANGES)
    positioner = Positioner(Oracle(cell))
    run_log = RunLog(tmp_path / "log", positioner)
    run_log.finish(positioner.run(cell, cell, on_step=run_log.write))
    return run_log.path


def interrupted_at(monkeypatch, method: str) -> list:
    """End the command by Ctrl-C where it waits; what was waited in."""
    waited = []

    def wait(self) -> None:
        waited.append(self)
        raise KeyboardInterrupt

    monkeypatch.setattr(method, wait)
    return waited


def test_a_log_is_served_until_ctrl_c(log, monkeypatch, capsys) -> None:
    waited = interrupted_at(monkeypatch, "servoscope.viewer.replay.Replay.until_closed")
    assert main(["view", str(log), "--port", "0"]) == 0
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("Open http://127.0.0.1:")
    assert "warning" not in err
    assert waited[0].current == 0


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--host", "0.0.0.0"], "one address of this machine"),  # noqa: S104
        (["--port", "70000"], "--port must be"),
        (["--model", "none"], "none"),
    ],
)
def test_what_cannot_be_shown_is_one_line(log, capsys, arguments, reason) -> None:
    assert main(["view", str(log), *arguments]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert reason in err


def test_a_folder_that_is_no_log_is_one_line(tmp_path, capsys) -> None:
    np.save(tmp_path / "other.npy", np.zeros(3))
    for path in (tmp_path, tmp_path / "other.npy", tmp_path / "nowhere"):
        assert main(["view", str(path)]) == 1
        err = capsys.readouterr().err
        assert err.count("\n") == 1
        assert "is not the log of a run, a data set folder or a model folder" in err


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    path = tmp_path_factory.mktemp("view") / "model"
    rehearsal_model().save(path)
    return path


def pressing(monkeypatch, *buttons: str) -> list:
    """Press buttons, one each time that the robot waits, and Ctrl-C at the end; the runs."""
    runs, left = [], list(buttons)
    first = LiveRun.__init__

    def init(self, positioner, robot, camera, history, show, say, **options) -> None:
        def say_and_press(words: str) -> None:
            say(words)
            if "press Step or Run" in words:
                getattr(self, left.pop(0))()

        first(self, positioner, robot, camera, history, show, say_and_press, **options)
        runs.append(self)

    monkeypatch.setattr(LiveRun, "__init__", init)
    monkeypatch.setattr("servoscope.commands.view.wait_for_ctrl_c", lambda: runs.append("waited"))
    return runs


def test_a_rehearsal_runs_as_the_buttons_say_and_its_log_can_be_shown(
    model, tmp_path, monkeypatch, capsys
) -> None:
    runs = pressing(monkeypatch, "step", "run")
    log = tmp_path / "log"
    arguments = ["view", str(model), "--rehearse", "--port", "0", "--log", str(log)]
    assert main(arguments) == 0
    err = capsys.readouterr().err
    assert "converged: " in err
    history = runs[0].history
    assert history.knows_truth
    assert np.abs(history.looks[0].truth).max() > 1
    for dof in ("tx", "rz"):
        series = history.series(dof)
        assert abs(series.truth[-1] - series.believed[-1]) < 0.2
    shown = read_log(log, PositioningModel.load(model))
    assert len(shown.looks) == len(history.looks)
    np.testing.assert_allclose(shown.path(), history.path())


def test_a_robot_of_ones_own_is_stopped_by_the_button_and_has_not_moved(
    model, tmp_path, monkeypatch, capsys
) -> None:
    (tmp_path / "own_cell.py").write_text(OWN.format(tests=TESTS))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.path", list(sys.path))
    runs = pressing(monkeypatch, "stop")
    assert main(["view", str(model), "--robot", "own_cell:Cell", "--port", "0"]) == 0
    assert "interrupted: Interrupted by the user. It was stopped." in capsys.readouterr().err
    own = sys.modules.pop("own_cell").Cell.made[0]
    assert own.stops == 1
    assert own.moves == 0
    assert runs[-1] == "waited"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_the_robot_waits_ends_the_command(
    model, monkeypatch, capsys, number
) -> None:
    monkeypatch.setattr(LiveRun, "pressed", lambda self: signal.raise_signal(number), raising=False)
    runs = pressing(monkeypatch, "pressed")
    assert main(["view", str(model), "--rehearse", "--port", "0"]) == 0
    assert "interrupted: Interrupted by" in capsys.readouterr().err
    assert "waited" not in runs


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["--rehearse", "--robot", "free"], "leave --robot out"),
        (["--rehearse", "--condition", "none"], "condition"),
        (["--camera", "opencv:0"], "leave it out"),
        (["--robot", "none"], "--robot must be"),
        (["--condition", "none"], "--condition must be"),
        ([], "no simulated robot"),
        (["--model", "other"], "leave --model out"),
        (["--rehearse", "--tolerance", "tq=1mm"], "tq"),
        (["--rehearse", "--workspace", "x=1:0"], "workspace"),
    ],
)
def test_runs_that_cannot_be_are_one_line(model, capsys, arguments, reason) -> None:
    assert main(["view", str(model), *arguments]) == 1
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert reason in err


def test_a_log_is_not_run(log, capsys) -> None:
    assert main(["view", str(log), "--rehearse"]) == 1
    assert "needs a model" in capsys.readouterr().err
