"""Aiming a camera by hand from the command line."""

import io
import json
import sys
import types

import numpy as np
import pytest
from rich.console import Console

from planar import RANGES
from planar_cell import Cell, Oracle
from servoscope.cli import main
from servoscope.commands import aim as command
from servoscope.commands.aim import _shown, _watch
from servoscope.positioning import PositioningModel, aim
from servoscope.positioning.aiming import AIM_SETTINGS


class Hand(Cell):
    """A camera that a person moves halfway back after every image, until it is interrupted."""

    def __init__(self, share=0.4, n_images=1):
        super().__init__(share * RANGES)
        self.n_left, self.is_closed = n_images, False

    def read(self):
        if self.n_left == 0:
            raise KeyboardInterrupt
        self.n_left -= 1
        image = super().read()
        HANDS[:] = [Hand.__new__(Hand)]
        HANDS[0].poses = [self.poses[-1]]
        self.poses.append(Cell(0.3 * self.delta_p).pose)
        return image

    def close(self):
        self.is_closed = True


HANDS = []


class Seeing(Oracle):
    """Sees where the camera was when the image was taken."""

    def __init__(self, std=np.nan, novelty=np.nan):
        super().__init__(None, std=std, novelty=novelty)

    @property
    def cell(self):
        return HANDS[0]

    @cell.setter
    def cell(self, cell):
        pass


@pytest.fixture
def own(monkeypatch):
    """A module of the user with cameras, and a model that sees where they are."""
    module = types.ModuleType("own")
    module.Near, module.Far = lambda: Hand(0.0), lambda: Hand(0.4)
    module.Live = lambda: Hand(0.4, n_images=12)
    module.Dead = lambda: types.SimpleNamespace(read=dead)
    monkeypatch.setitem(sys.modules, "own", module)
    monkeypatch.setattr(PositioningModel, "load", lambda folder: Seeing())
    return module


def dead():
    raise OSError("unplugged\nby hand")


def run(capsys, *arguments):
    code = main(["aim", "model", *arguments])
    said = capsys.readouterr()
    return code, said.out, said.err


def test_one_reading_is_printed_for_people_and_for_programs(own, capsys):
    code, out, _ = run(capsys, "--camera", "own:Far", "--once")
    assert code == 0
    assert "from where it was." in out
    assert out.count(" mm ") + out.count(" deg ") >= 6
    code, out, _ = run(capsys, "--camera", "own:Far", "--once", "--json")
    facts = json.loads(out)
    assert (code, facts["status"], facts["axes"]) == (0, "move", "poses")
    assert list(facts["correction"]) == ["tx", "ty", "tz", "rx", "ry", "rz"]
    assert len(facts["words"]) == 6
    assert facts["distance_mm"] > 10


def test_within_the_tolerance_it_says_so(own, capsys):
    code, out, _ = run(capsys, "--camera", "own:Near", "--once", "--json")
    assert (code, json.loads(out)["status"]) == (0, "aimed")


def test_a_view_that_is_not_recognised_fails_in_a_line(own, capsys, monkeypatch):
    monkeypatch.setattr(PositioningModel, "load", lambda folder: Seeing(novelty=2.0))
    code, out, err = run(capsys, "--camera", "own:Far", "--once", "--json")
    assert (code, json.loads(out)["status"]) == (1, "unrecognised")
    assert err.startswith("servoscope: The view is not recognised. The image is unlike")
    assert len(err.splitlines()) == 1


def test_without_a_terminal_every_image_is_a_line_until_ctrl_c(own, capsys):
    code, out, err = run(capsys, "--camera", "own:Live")
    assert (code, err) == (0, "")
    lines = out.splitlines()
    assert len(lines) == 12
    assert "from where it was. tx " in lines[0]
    assert "is back" in lines[-1]


def test_the_terminal_shows_every_image(own, monkeypatch):
    out = io.StringIO()
    camera = Hand(0.4, n_images=12)
    _watch(Seeing(), camera, AIM_SETTINGS, Console(file=out, force_terminal=True, width=100))
    assert "The camera is back" in out.getvalue()
    assert out.getvalue().count("from where it was") >= 12
    assert camera.n_left == 0


@pytest.mark.parametrize("encoding", ["utf-8", "ascii"])
def test_arrows_and_words_go_together_in_every_encoding(encoding):
    file = io.TextIOWrapper(io.BytesIO(), encoding=encoding)
    console = Console(file=file, force_terminal=False, width=80)
    HANDS[:] = [Cell(np.zeros(6))]
    reading = aim(Seeing(std=1e-3), HANDS[0].read())
    object.__setattr__(reading, "axes", "camera")
    motion = np.eye(4)
    motion[:3, 3] = 0.02, -0.004, -1e-4
    object.__setattr__(reading, "motion", motion)
    console.print(_shown(reading, AIM_SETTINGS, console))
    file.flush()
    lines = file.buffer.getvalue().decode(encoding).splitlines()
    arrows = command._ARROWS if encoding == "utf-8" else command._PLAIN_ARROWS
    right, up, farther = 3 * arrows[0][1], 2 * arrows[1][0], arrows[2][0]
    begins = [line.split()[:2] for line in lines[:3]]
    assert begins == [[right, "right"], [up, "up"], [farther, "farther"]]
    assert "20.00 mm" in lines[0]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--camera", "own:Far", "--json"], "give --once"),
        (["--camera", "own:Nobody"], "has no 'Nobody'"),
        (["--camera", "eye"], "The camera must be opencv:N, folder:PATH"),
        (["--camera", "own:Dead"], "The camera failed: unplugged by hand"),
        (["--camera", "own:Far", "--tolerance-mm", "-1"], "tolerance_mm"),
    ],
)
def test_bad_options_are_a_line(own, capsys, options, said):
    code, _, err = run(capsys, *options)
    assert code == 1
    assert said in err
    assert len(err.splitlines()) == 1
