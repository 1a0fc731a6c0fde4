"""``servoscope view`` of what has been."""

import numpy as np
import pytest

from planar import RANGES
from planar_cell import Cell, Oracle
from servoscope.cli import main
from servoscope.positioning.look_and_move import Positioner
from servoscope.positioning.run_log import RunLog

pytest.importorskip("viser")


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
    assert main(["view", str(tmp_path)]) == 1
    assert capsys.readouterr().err.count("\n") == 1
