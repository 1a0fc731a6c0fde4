"""The robot moves when a person says so, and stops when a person says so."""

import threading
import time

import numpy as np
import pytest

from planar import RANGES
from planar_cell import Oracle, Stoppable
from servoscope.positioning.look_and_move import Positioner
from servoscope.positioning.settings import LoopSettings
from servoscope.viewer.history import History, Setting
from servoscope.viewer.live import LiveRun


def live(cell, on_wait=None, distort=lambda delta_p: 0.8 * delta_p, settings=None, **options):
    """A run, and what it said; `on_wait` is called with it whenever it waits."""
    said: list[str] = []
    estimator = Oracle(cell, distort, std=0.01)
    history = History(Setting.of_estimator(estimator))

    def say(words: str) -> None:
        said.append(words)
        if "press Step or Run" in words and on_wait is not None:
            on_wait(run)

    run = LiveRun(
        Positioner(estimator, settings), cell, cell, history, lambda k: None, say, **options
    )  # fmt: skip
    return run, said


def test_nothing_moves_before_a_button_is_pressed_and_the_first_move_is_shown() -> None:
    cell = Stoppable(0.5 * RANGES)
    moves: list[int] = []

    def stop_later(run: LiveRun) -> None:
        def press() -> None:
            time.sleep(0.2)
            moves.append(len(cell.poses) - 1)
            run.stop()

        threading.Thread(target=press).start()

    run, said = live(cell, stop_later)
    result = run.until_end()
    assert moves == [0]
    assert (result.status, result.moves, cell.stops) == ("interrupted", 0, 1)
    assert run.history.looks[0].next_camera is not None
    assert "The move from here" in said[0]
    assert said[-1] == run.history.end == f"interrupted: {result.message}"


def test_a_step_is_one_move_and_one_look() -> None:
    cell, waits = Stoppable(0.5 * RANGES), []

    def press(run: LiveRun) -> None:
        waits.append(len(cell.poses) - 1)
        run.stop() if len(waits) == 3 else run.step()

    run, _ = live(cell, press)
    assert run.until_end().status == "interrupted"
    assert waits == [0, 1, 2]
    assert len(cell.poses) == 3


def test_run_goes_on_to_the_end_without_waiting() -> None:
    cell, waits = Stoppable(0.5 * RANGES), []

    def press(run: LiveRun) -> None:
        waits.append(run)
        run.run()

    run, said = live(cell, press)
    result = run.until_end()
    assert result.status == "converged"
    assert len(waits) == 1
    assert result.moves > 2
    assert len(run.history.looks) == len(result.steps)
    assert said[-1].startswith("converged")


def test_a_step_while_running_holds_at_the_next_look() -> None:
    cell, waits = Stoppable(0.5 * RANGES), []

    def press(run: LiveRun) -> None:
        waits.append(len(cell.poses) - 1)
        run.run() if len(waits) == 1 else run.stop()

    run, _ = live(cell, press, on_step=lambda step, image: len(cell.poses) == 3 and run.step())
    assert run.until_end().status == "interrupted"
    assert waits == [0, 2]


def test_stop_ends_a_move_that_is_under_way() -> None:
    cell = Stoppable(0.5 * RANGES, seconds=20.0)

    def press(run: LiveRun) -> None:
        def stop() -> None:
            cell.is_moving.wait(5)
            run.stop()

        threading.Thread(target=stop).start()
        run.run()

    run, _ = live(cell, press)
    start = time.monotonic()
    result = run.until_end()
    assert time.monotonic() - start < 5
    assert result.status == "interrupted"
    assert cell.stops == 1
    assert len(cell.poses) == 1


def test_stop_stops_the_robot_where_no_signal_can_end_the_move() -> None:
    cell = Stoppable(0.5 * RANGES, seconds=20.0)
    run, _ = live(cell, LiveRun.run)
    results = []
    thread = threading.Thread(target=lambda: results.append(run.until_end()))
    thread.start()
    assert cell.is_moving.wait(5)
    run.stop()
    thread.join(5)
    assert results[0].status == "robot_fault"
    assert cell.stops >= 1
    assert len(cell.poses) == 1


def test_stop_stops_the_robot_after_the_end_too_and_no_button_moves_it() -> None:
    cell = Stoppable(0.5 * RANGES)
    run, _ = live(cell, LiveRun.run)
    run.until_end()
    stops, poses = cell.stops, len(cell.poses)
    run.step()
    run.run()
    run.stop()
    assert cell.stops == stops + 1
    assert len(cell.poses) == poses


@pytest.mark.parametrize(("button", "returns"), [("step", False), ("run", True)])
def test_moves_that_were_not_shown_are_made_while_running_only(button: str, returns: bool) -> None:
    cell = Stoppable(0.5 * RANGES)
    settings = LoopSettings(largest_innovation=None, workspace_margin=9.0)
    press = getattr(LiveRun, button)
    run, _ = live(cell, press, lambda delta_p: -0.3 * delta_p, settings)
    result = run.until_end()
    assert (result.status == "diverged") == returns
    assert (result.returned_to is not None) == returns
    if not returns:
        assert "drive back" in result.message
        assert len(cell.poses) == len(result.steps)


def test_what_is_true_is_kept_beside_what_is_believed() -> None:
    cell = Stoppable(0.5 * RANGES)
    truth = np.eye(4)
    truth[0, 3] = 1e-3
    run, _ = live(cell, LiveRun.stop, truth=lambda: truth)
    run.until_end()
    np.testing.assert_allclose(run.history.series("tx").truth, 1.0)
