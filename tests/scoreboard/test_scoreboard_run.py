"""The scoreboard from end to end, on small images and with stand-ins for what learns."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from html_page import check_page
from scoreboard_stand_in import replace_learners
from servoscope.cli import main
from servoscope.errors import InvalidInputError
from servoscope.scoreboard import run as scoreboard_run
from servoscope.scoreboard.cell import CONDITIONS, SCENES
from servoscope.scoreboard.methods import METHODS
from servoscope.scoreboard.page import write_scoreboard
from servoscope.scoreboard.plan import Plan
from servoscope.scoreboard.run import Scoreboard
from servoscope.storage.run_folder import open_run_folder

CONDITIONS_RUN = ("range_1.0", "noise_10", "depth_1.5")
PLAN = Plan(
    starts=2,
    image_size=64,
    seed=3,
    schedules=dict.fromkeys(("ours", "networks"), "6@1.0,4@0.1"),
    conditions=CONDITIONS_RUN,
)


@pytest.fixture(autouse=True)
def _stand_ins(monkeypatch: pytest.MonkeyPatch) -> None:
    replace_learners(monkeypatch)
    monkeypatch.setattr("servoscope.scoreboard.methods.MOST_MOVES_PHOTOMETRIC", 6)


def run(path: Path, n_jobs: int = 1, plan: Plan = PLAN) -> Scoreboard:
    folder = open_run_folder(path, {"seed": plan.seed}, resume=True)
    board = Scoreboard(folder, plan, n_jobs=n_jobs)
    board.run()
    return board


def without_clock(path: Path) -> str:
    """All trials, without what a clock says."""
    trials = {file.name: json.loads(file.read_text()) for file in path.glob("trials/*.json")}
    for by_method in trials.values():
        for trial in (trial for trials in by_method.values() for trial in trials):
            trial["decisions_ms"] = len(trial["decisions_ms"])
    return json.dumps(trials, sort_keys=True)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scoreboard") / "run"
    with pytest.MonkeyPatch.context() as patch:
        replace_learners(patch)
        patch.setattr("servoscope.scoreboard.methods.MOST_MOVES_PHOTOMETRIC", 6)
        run(path)
    return path


def test_json_has_every_scene_condition_and_method(finished: Path) -> None:
    board = json.loads((finished / "scoreboard.json").read_text())
    assert board.keys() >= {"seed", "starts", "machine", "timings_s", "targets", "results"}
    assert (board["seed"], board["starts"]) == (3, 2)
    assert board["machine"].keys() == {"cores", "python"}
    assert tuple(board["results"]) == SCENES
    for by_condition in board["results"].values():
        assert tuple(by_condition) == CONDITIONS_RUN
        for by_method in by_condition.values():
            assert tuple(by_method) == METHODS
            assert all(numbers["trials"] == 2 for numbers in by_method.values())
    assert {target["scene"] for target in board["targets"]} == set(SCENES)


def test_a_depth_is_told_to_the_baseline_alone(finished: Path) -> None:
    results = json.loads((finished / "scoreboard.json").read_text())["results"]
    for by_condition in results.values():
        for method in ("ours", "networks"):
            assert by_condition["depth_1.5"][method] == by_condition["range_1.0"][method]
    trials = json.loads((finished / "trials/cylinder_head_depth_1.5.json").read_text())
    assert trials.keys() == {"photometric"}


@pytest.mark.slow
def test_two_processes_give_the_trials_of_one(finished: Path, tmp_path: Path) -> None:
    run(tmp_path / "run", n_jobs=2, plan=replace(PLAN, conditions=("noise_10",)))
    ours, theirs = (json.loads(without_clock(path)) for path in (tmp_path / "run", finished))
    assert sorted(ours) == sorted(f"{scene}_noise_10.json" for scene in SCENES)
    assert ours.items() <= theirs.items()


def test_a_run_that_was_stopped_goes_on_where_it_was(
    finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    blocks, run_block = [], scoreboard_run._run_block

    def count(*arguments: object) -> object:
        blocks.append(arguments[2][:2])
        if len(blocks) == stop_at:
            raise KeyboardInterrupt
        return run_block(*arguments)

    monkeypatch.setattr(scoreboard_run, "_run_block", count)
    stop_at = 10
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path / "run")
    done, blocks, stop_at = set(blocks[:-1]), [], 0
    run(tmp_path / "run")
    assert without_clock(tmp_path / "run") == without_clock(finished)
    assert len(done & set(blocks)) <= 1
    blocks = []
    run(tmp_path / "run")
    assert not blocks


def test_the_page_needs_nothing_else_and_escapes_all(finished: Path) -> None:
    board = json.loads((finished / "scoreboard.json").read_text())
    board["machine"]["python"] = "<script>alert(1)</script>"
    folder = open_run_folder(finished, {"seed": 3}, resume=True)
    trials = {scene: Scoreboard(folder, PLAN).trials(scene) for scene in SCENES}
    page = check_page(write_scoreboard(finished, board, trials))
    assert "<script>alert(1)</script>" in page.text
    assert len(page.all("img")) == 2
    assert (finished / "figures" / "trajectories.png").stat().st_size > 10_000
    table = (finished / "scoreboard.md").read_text()
    assert table.count("| range_1.0 |") == 2
    assert "MISSED" in table


def test_the_command_prints_a_table_or_json(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("servoscope.scoreboard.plan.QUICK_CONDITIONS", ("gain_0.8",))
    monkeypatch.setattr(
        "servoscope.scoreboard.plan.QUICK_SCHEDULES", {"ours": "6@1.0", "networks": "6@1.0"}
    )
    out = ["--out", str(tmp_path / "run")]
    command = ["benchmark", "positioning", "--quick", "--starts", "1", "--image-size", "64", *out]
    assert main([*command, "--jobs", "1"]) == 0
    printed = capsys.readouterr().out
    assert "Textured plane" in printed
    assert "(missed)" in printed
    assert main(command) == 1
    assert "--resume" in capsys.readouterr().err
    assert main([*command, "--resume", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["results"].keys() == set(SCENES)
    assert main([*command, "--seed", "9", "--resume"]) == 1
    assert "seed" in capsys.readouterr().err


def test_plans_are_checked_and_quick_ones_have_both_scenes_and_what_matters() -> None:
    quick = Plan(quick=True)
    assert {"range_1.0", "gain_0.8", "covered_10", "noise_10"} <= set(quick.conditions)
    assert Plan().conditions == tuple(CONDITIONS)
    assert Plan().n_trials("cylinder_head", "range_1.0", "ours") == 100
    assert Plan().n_trials("textured_plane", "range_1.0", "photometric") == 100
    assert Plan(starts=3).n_trials("cylinder_head", "arm", "photometric") == 3
    with pytest.raises(InvalidInputError, match="starts must be a whole number from 1, got 0"):
        Plan(starts=0)
    with pytest.raises(InvalidInputError, match="got 'rain'"):
        Plan(conditions=("rain",))
