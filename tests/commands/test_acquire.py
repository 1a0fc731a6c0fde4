"""``servoscope acquire`` and what ``servoscope info`` tells of it."""

import json
import sys
from pathlib import Path

import pytest

from servoscope.cli import main
from servoscope.data.schedule import RECOMMENDED, format_schedule
from servoscope.robots.registry import ROBOTS

SMALL = ("--image-size", "16", "--jobs", "1")


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_rings_part_and_robot_are_told(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["acquire", "out", "--schedule", "3@1.5,2@0.1", "--variant", "2", *SMALL]) == 0
    told = capsys.readouterr().out
    assert "3@1.5,2@0.1" in told
    assert "cylinder_head, variant 2" in told
    assert main(["info", "out", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["images"] == 5
    assert facts["rings"] == "3@1.5,2@0.1"
    assert facts["part"] == "cylinder_head, variant 2"
    assert facts["robot"] == "free"
    assert facts["ranges"]["tx"] == "37.5 mm"


def test_without_a_schedule_there_is_one_ring(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["acquire", "out", "--n-images", "2", "--json", *SMALL]) == 0
    assert json.loads(capsys.readouterr().out)["rings"] == "2@1.0"


def test_default_is_a_schedule(monkeypatch: pytest.MonkeyPatch) -> None:
    configs = []

    def take(_: Path, config: object, **__: object) -> None:
        configs.append(config)
        raise KeyboardInterrupt

    monkeypatch.setattr("servoscope.acquisition.acquire", take)
    assert main(["acquire", "out", "--schedule", "default", *SMALL]) == 130
    assert configs[0].plan()["rings"] == format_schedule(RECOMMENDED)


def test_poses_that_were_replaced_are_told(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from servoscope.errors import RobotFaultError
    from servoscope.robots.free_camera import FreeCamera

    moves = []

    class Reluctant(FreeCamera):
        def move_to(self, pose: object) -> None:
            moves.append(pose)
            if len(moves) <= 2:
                raise RobotFaultError("not yet")
            super().move_to(pose)

    monkeypatch.setitem(
        ROBOTS.built_in, "arm", lambda scene, T, _, rng: Reluctant(scene, T, rng=rng)
    )
    assert main(["acquire", "out", "--n-images", "3", "--robot", "arm", *SMALL]) == 0
    assert "arm, 2 poses out of reach drawn anew" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--schedule", "5@x"], "rings of images@factor"),
        (["--schedule", "5@nan"], "factor must be above 0"),
        (["--schedule", "-5@1"], "from 1 to 1000000, got -5"),
        (["--schedule", "9000000@1"], "from 1 to 1000000, got 9000000"),
        (["--variant", "-1"], "variant must be a whole number from 0"),
    ],
)
def test_wrong_requests_end_with_one_line_and_leave_nothing(
    arguments: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["acquire", "out", *arguments]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert message in err
    assert len(err.splitlines()) == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("arguments", [["--part", "valve"], ["--schedule"]])
def test_unknown_names_are_wrong_usage(arguments: list[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["acquire", "out", *arguments])


def test_an_unknown_robot_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["acquire", str(tmp_path / "out"), "--robot", "crane"]) == 1
    err = capsys.readouterr().err
    assert "robot must be one of " in err
    assert "got 'crane'" in err
    assert len(err.splitlines()) == 1


def test_images_and_rings_together_are_wrong_usage(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="2"):
        main(["acquire", "out", "--schedule", "5@1", "--n-images", "4"])
    out, err = capsys.readouterr()
    assert out == ""
    assert "--n-images" in err
    assert "--schedule" in err
    assert not list(tmp_path.iterdir())


DRIVER = """
import numpy as np
from planar_cell import Cell

class Robot(Cell):
    def __init__(self):
        super().__init__(np.zeros(6), noise=1.0)

    def move_to(self, pose):
        self.poses.append(pose)

    def stop(self):
        print("stopped")
"""
OWN = ("acquire", "out", "--robot", "my_press:Robot", "--n-images", "6", "--translation-mm", "8")


def test_a_robot_of_ones_own_moves_once_it_is_agreed_to(capsys, monkeypatch) -> None:
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.delitem(sys.modules, "my_press", raising=False)
    Path("my_press.py").write_text(DRIVER)
    assert main([*OWN, "--preview"]) == 0
    said = capsys.readouterr().out
    assert "farthest from the reference" in said
    assert "stopped" not in said
    assert Path("out/plan.png").exists()
    assert main([*OWN]) == 1
    assert capsys.readouterr().err.endswith("Nobody can be asked here; agree with --yes.\n")
    assert main([*OWN, "--yes", "--json"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out.removeprefix("stopped\n"))["images"] == 6
    assert "6 images, " in err
    assert main([*OWN, "--until", "t=1mm", "--yes"]) == 1
    assert main(["acquire", "other", "--robot", "my_press:None", "--yes"]) == 1


def test_a_simulated_acquisition_is_previewed_too(capsys) -> None:
    assert main(["acquire", "out", "--schedule", "10@1.6", "--preview"]) == 0
    assert "10 images" in capsys.readouterr().out
    assert not Path("out/meta.json").exists()


def test_a_preview_is_json_on_request(capsys) -> None:
    plan = ["acquire", "out", "--schedule", "10@1.6", "--preview", "--json"]
    assert main(plan) == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["images"], facts["picture"]) == (10, str(Path("out/plan.png")))
    assert facts["travel_m"] > 0


def test_a_set_that_is_whole_is_said_to_be(capsys) -> None:
    for again in (False, True):
        assert main(["acquire", "out", "--n-images", "2", "--part", "textured_plane", *SMALL]) == 0
        out, err = capsys.readouterr()
        assert ("out is whole already: nothing was taken" in err) is again
        assert "source           simulated textured plane, seed 0, translation mm 25," in out
        assert "{" not in out
