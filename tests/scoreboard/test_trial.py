"""What a trial tells is what a simulation knows, and what a robot does not."""

import json

import numpy as np
import pytest

from scoreboard_stand_in import FullStep, Nearest, Oracle
from servoscope.acquisition import AcquisitionConfig, acquire
from servoscope.positioning import LoopSettings
from servoscope.scoreboard.cell import CONDITIONS, robot_at_reference, robot_at_start
from servoscope.scoreboard.methods import loop_settings
from servoscope.scoreboard.trial import Trial, run_start, run_trial


def oracle_trial(condition: str, settings: LoopSettings | None = None) -> tuple[Trial, Oracle]:
    reference = robot_at_reference("textured_plane", CONDITIONS[condition].robot, 64)
    robot = robot_at_start("textured_plane", condition, 64, 0, 2)
    oracle = Oracle(robot, reference, pivot=0.55)
    return run_trial(robot, reference, oracle, settings or LoopSettings()), oracle


@pytest.mark.parametrize("condition", ["range_1.0", "arm"])
def test_who_knows_the_truth_succeeds_in_a_few_moves(condition: str) -> None:
    trial, oracle = oracle_trial(condition)
    assert trial.status == "converged"
    assert trial.succeeded
    assert trial.moves <= 3
    assert trial.moves_to_success <= trial.moves
    assert trial.start_mm > 10
    assert len(trial.path_mm) == len(trial.path_deg) == trial.moves + 1 == len(trial.decisions_ms)
    np.testing.assert_allclose(trial.truth, oracle.delta_p(), atol=1e-9)
    np.testing.assert_allclose(trial.believed, trial.truth, atol=1e-9)


def test_a_robot_that_misses_is_judged_by_where_its_camera_is() -> None:
    exact, _ = oracle_trial("range_1.0")
    settings = loop_settings("ours", CONDITIONS["repeatability"].repeatability)
    missing, _ = oracle_trial("repeatability", settings)
    assert exact.end_mm < 1e-3
    assert 1e-3 < missing.end_mm < 1.0


def test_a_run_that_is_cut_short_has_the_way_that_it_went() -> None:
    trial, _ = oracle_trial("range_1.0", LoopSettings(max_moves=0))
    assert (trial.status, trial.moves, len(trial.path_mm)) == ("max_moves", 0, 1)
    assert not trial.succeeded
    assert trial.moves_to_success is None
    assert trial.end_mm == trial.start_mm


def test_a_trial_comes_back_from_json_as_it_was() -> None:
    trial, _ = oracle_trial("range_1.0")
    text = json.dumps(trial.to_dict(), allow_nan=False)
    assert Trial(**json.loads(text)) == trial


def test_a_start_out_of_reach_is_a_fault_of_the_robot(monkeypatch: pytest.MonkeyPatch) -> None:
    from servoscope.errors import RobotFaultError

    def refuse(*_: object) -> None:
        raise RobotFaultError("too far")

    monkeypatch.setattr("servoscope.scoreboard.trial.robot_at_start", refuse)
    stand_in: FullStep = None  # never asked
    trial = run_start("textured_plane", "arm", 64, 0, 2, stand_in, LoopSettings())
    assert (trial.status, trial.moves, trial.decisions_ms) == ("robot_fault", 0, [])
    assert trial.end_mm == trial.start_mm > 1


def test_estimates_that_hop_to_both_sides_of_the_reference_end_in_time(tmp_path) -> None:
    """The view is displaced by a little more than may be, and the mean asks for no move."""
    config = AcquisitionConfig(schedule=((6, 1.0), (4, 0.1)), image_size=64, seed=3)
    nearest = Nearest(acquire(tmp_path / "data", config, n_jobs=1))
    settings = loop_settings("networks", CONDITIONS["range_0.4"].repeatability)
    trial = run_start("cylinder_head", "range_0.4", 64, 3, 0, nearest, settings)
    assert trial.moves <= settings.max_moves
    assert "led to no decision" not in trial.message
