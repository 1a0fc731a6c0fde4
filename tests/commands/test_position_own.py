"""Positioning a robot of one's own from the command line."""

import io
import json
import signal
import sys
import types

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from planar import RANGES
from planar_cell import Cell, Oracle, distance_from_reference
from rtde_stand_in import Controller, modules
from servoscope.cli import main
from servoscope.poses import inverse_transform, rigid_transform
from servoscope.positioning import PositioningModel
from servoscope.robots import ur_arm


class Driver(Cell):
    """A robot as a user writes one: it goes where it is sent, and notes what it was asked for."""

    def __init__(self):
        super().__init__(0.5 * RANGES)
        self.calls = []

    def move(self, displacement):
        self.calls.append("move")
        return super().move(displacement)

    def stop(self):
        self.calls.append("stop")

    def close(self):
        self.calls.append("close")


class Arm:
    """The same without images."""

    def __init__(self):
        self.driver = Driver()
        DRIVERS[:] = [self.driver]

    @property
    def pose(self):
        return self.driver.pose

    def __getattr__(self, name):
        if name == "read":
            raise AttributeError(name)
        return getattr(self.driver, name)


class GoTo:
    """A robot that is sent to poses."""

    def __init__(self):
        self.driver = Driver()
        DRIVERS[:] = [self.driver]

    @property
    def pose(self):
        return self.driver.pose

    def move_to(self, pose):
        self.driver.move(inverse_transform(self.pose) @ pose)

    def stop(self):
        self.driver.stop()

    def close(self):
        self.driver.close()


class Eye:
    def read(self):
        return DRIVERS[-1].read()

    def close(self):
        DRIVERS[-1].calls.append("close the camera")


DRIVERS = []


@pytest.fixture
def own(monkeypatch):
    """The module `own` of the user; what it makes is in `DRIVERS`."""

    def make():
        DRIVERS[:] = [Driver()]
        return DRIVERS[0]

    module = types.ModuleType("own")
    module.Arm, module.Both, module.Eye, module.GoTo = Arm, make, Eye, GoTo
    monkeypatch.setitem(sys.modules, "own", module)
    yield module
    DRIVERS.clear()


@pytest.fixture
def model(own, monkeypatch):
    """A model that sees where the camera is."""

    class Seeing(Oracle):
        cell = property(lambda self: DRIVERS[0], lambda self, cell: None)

    monkeypatch.setattr(PositioningModel, "load", lambda folder: Seeing(None))
    return "model"


class Terminal(io.StringIO):
    def isatty(self):
        return True


def run(capsys, model, *arguments):
    code = main(["position", str(model), *map(str, arguments)])
    said = capsys.readouterr()
    return code, said.out, said.err


@pytest.mark.parametrize("robot", ["own:Arm", "own:GoTo"])
def test_a_robot_and_its_camera_come_back_and_are_stopped_and_closed(own, model, capsys, robot):
    code, out, err = run(capsys, model, "--robot", robot, "--camera", "own:Eye", "--yes", "--json")
    result = json.loads(out)
    (driver,) = DRIVERS
    assert (code, result["status"]) == (0, "converged")
    assert "true_error" not in result
    assert distance_from_reference(driver) < 1e-3
    assert driver.calls == ["move"] * result["moves"] + ["stop", "close", "close the camera"]
    assert "The first move is " in err


def test_an_arm_of_universal_robots_comes_back(own, model, capsys, monkeypatch):
    controller = Controller()
    for name, module in zip(("rtde_control", "rtde_receive"), modules(controller), strict=True):
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.setattr(ur_arm, "_check_reachable", lambda host: None)

    class Carried(Cell):
        """A cell whose camera is on the arm."""

        @property
        def pose(self):
            x = controller.where()
            return rigid_transform(Rotation.from_rotvec(x[3:]).as_matrix(), x[:3])

    start = Cell(0.3 * RANGES).pose
    turn = Rotation.from_matrix(start[:3, :3]).as_rotvec()
    controller.pose = controller.target = np.array([*start[:3, 3], *turn])
    DRIVERS[:] = [Carried(np.zeros(6))]
    monkeypatch.setattr(Eye, "close", lambda self: None)
    arm = ["--robot", "ur:192.0.2.7?speed=1", "--camera", "own:Eye"]
    code, out, err = run(capsys, model, *arm, "--yes", "--json")
    assert (code, json.loads(out)["status"]) == (0, "converged"), err
    assert distance_from_reference(DRIVERS[0]) < 1e-3
    assert controller.stops
    assert controller.scripts_stopped == 1


def test_the_first_move_is_said_and_asked_for_once(own, model, capsys, monkeypatch):
    monkeypatch.setattr(sys, "stdin", Terminal("y\n"))
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    code, out, err = run(capsys, model, "--robot", "own:Both", "--max-step-mm", 20)
    assert err.count("Move the robot? [y/N]") == 1
    assert "at most 12 moves, none longer than 20 mm" in err
    assert "true" not in out
    assert "predicted error" not in out  # nothing is believed
    first = float(err.split("The first move is ")[1].split(",")[0])
    assert 0 < abs(first) <= 20
    assert code == 0
    assert DRIVERS[0].calls.count("move") > 1


@pytest.mark.parametrize("answer", ["n\n", "\n", ""])
def test_without_a_yes_nothing_moves(own, model, capsys, monkeypatch, answer):
    monkeypatch.setattr(sys, "stdin", Terminal(answer))
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    code, _, err = run(capsys, model, "--robot", "own:Both")
    assert code == 1
    assert "Not confirmed; nothing was moved." in err
    assert DRIVERS[0].calls == ["stop", "close"]


def test_where_nobody_can_be_asked_nothing_moves(own, model, capsys, monkeypatch):
    monkeypatch.setattr(sys, "stdin", io.StringIO("y\n"))
    code, _, err = run(capsys, model, "--robot", "own:Both")
    assert code == 1
    assert "agree with --yes" in err
    assert DRIVERS[0].calls == ["stop", "close"]


def test_a_dry_run_asks_nothing_and_moves_nothing(own, model, capsys, monkeypatch):
    monkeypatch.setattr(sys, "stdin", io.StringIO())
    code, out, _ = run(capsys, model, "--robot", "own:Both", "--dry-run", "--json")
    assert (code, json.loads(out)["status"]) == (0, "dry_run")
    assert DRIVERS[0].calls == ["close"]


def test_ctrl_c_stops_the_robot(own, model, capsys, monkeypatch):
    def interrupted(self, displacement):
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(Driver, "move", interrupted)
    code, _, _ = run(capsys, model, "--robot", "own:Both", "--yes", "--move-timeout-s", 20)
    assert code == 130
    assert DRIVERS[0].calls == ["stop", "close"]


def test_a_fault_of_the_driver_is_a_line(own, model, capsys, monkeypatch):
    def refused(self, displacement):
        raise RuntimeError("joint 3\nis hot")

    monkeypatch.setattr(Driver, "move", refused)
    code, _, err = run(capsys, model, "--robot", "own:Both", "--yes")
    assert code == 1
    assert "The robot did not move: joint 3 is hot It was stopped." in err.splitlines()[-1]


def test_images_of_another_size_are_refused(own, model, capsys, monkeypatch):
    monkeypatch.setattr(Eye, "read", lambda self: np.zeros((32, 48), np.uint8))
    code, _, err = run(capsys, model, "--robot", "own:Arm", "--camera", "own:Eye", "--yes")
    assert code == 1
    assert "takes images of 48 x 48 pixels, but the camera gave 48 x 32" in err


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--robot", "own:Arm", "--yes"], "say which camera it carries"),
        (["--robot", "own:Both", "--start", "1"], "starts where it stands"),
        (["--robot", "own:Both", "--condition", "gain_0.8"], "starts where it stands"),
        (["--robot", "own:Both", "--camera", "own:Nobody", "--yes"], "has no 'Nobody'"),
        (["--robot", "free", "--camera", "own:Eye"], "--camera is of robots of your own"),
        (["--robot", "nobody:Arm", "--yes"], "there is no module 'nobody'"),
    ],
)
def test_bad_options_are_a_line(own, model, capsys, options, said):
    code, _, err = run(capsys, model, *options)
    assert code == 1
    assert said in err
    assert len(err.splitlines()) == 1
