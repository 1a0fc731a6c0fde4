"""An arm of Universal Robots, with a stand-in of the controller's interfaces."""

import inspect
import sys
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rtde_stand_in import (
    START,
    Controller,
    RTDEControlInterface,
    RTDEReceiveInterface,
    modules,
)
from servoscope.errors import (
    InvalidInputError,
    RobotFaultError,
    RobotStoppedError,
    ServoscopeError,
)
from servoscope.poses import pose_error, rigid_transform
from servoscope.robots import ur_arm
from servoscope.robots.devices import open_robot


@pytest.fixture
def controller(monkeypatch):
    one = Controller()
    control, receive = modules(one)
    monkeypatch.setitem(sys.modules, "rtde_control", control)
    monkeypatch.setitem(sys.modules, "rtde_receive", receive)
    monkeypatch.setattr(ur_arm, "_check_reachable", lambda host: None)
    return one


@pytest.fixture
def arm(controller):
    return open_robot("ur:192.0.2.7?speed=0.2&timeout=2")


def ahead(arm, metres=0.02, degrees=5.0):
    turn = Rotation.from_euler("z", degrees, degrees=True).as_matrix()
    return arm.pose @ rigid_transform(turn, [0.0, 0.0, metres])


def test_the_pose_is_a_rotation_vector_in_metres(arm):
    expected = rigid_transform(Rotation.from_rotvec(START[3:]).as_matrix(), START[:3])
    np.testing.assert_allclose(arm.pose, expected, atol=1e-12)


def test_it_goes_where_it_is_sent_and_returns_once_it_stands(arm, controller):
    goal = ahead(arm)
    begin = time.monotonic()
    arm.move_to(goal)
    assert time.monotonic() - begin >= 0.02 / 0.2
    distance, angle = pose_error(goal, arm.pose)
    assert distance < 1e-9
    assert angle < 1e-7
    assert not controller.stops


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"protective_at": 0.05}, "in protective stop; see what it met"),
        ({"contact_at": 0.05}, "force at its tool changed by 80 N"),
        ({"stuck_at": 0.05}, r"stands \d\d\.\d mm from where it was sent"),
        ({"emergency": True}, "in emergency stop"),
        ({"safety_mode": 5}, "stopped by a safeguard"),
        ({"robot_mode": 5}, "is not running .mode 5.; release its brakes"),
        ({"accepts": False}, "refused the move"),
        ({"is_connected": False}, "lost its connection"),
        ({"is_program_running": False, "reuploads": False}, "in remote control"),
    ],
)
def test_what_stops_it_is_said_in_a_line_and_it_stands(arm, controller, monkeypatch, changes, said):
    monkeypatch.setattr(ur_arm, "_LONGEST_REST", 0.2)
    goal = ahead(arm, 0.05)
    for name, value in changes.items():
        setattr(controller, name, value)
    with pytest.raises(RobotStoppedError, match=said) as caught:
        arm.move_to(goal)
    assert str(caught.value).startswith("The arm at 192.0.2.7 ")
    assert len(str(caught.value).splitlines()) == 1
    assert not controller.is_moving()


def test_a_pose_out_of_reach_is_refused_and_nothing_moves(arm, controller):
    controller.reachable = False
    with pytest.raises(RobotFaultError, match="cannot reach the pose"):
        arm.move_to(ahead(arm))
    assert controller.duration == 0


def test_a_move_that_takes_too_long_is_stopped(controller):
    arm = open_robot("ur:192.0.2.7?speed=0.01&timeout=0.2")
    with pytest.raises(RobotStoppedError, match=r"not get there in 0\.2 s"):
        arm.move_to(ahead(arm, 0.05))
    assert controller.stops == [1.0]


def test_a_stop_from_another_thread_ends_the_move(arm, controller):
    threading.Timer(0.05, arm.stop).start()
    with pytest.raises(RobotStoppedError, match="was stopped during the move"):
        arm.move_to(ahead(arm, 0.1))
    assert not controller.is_moving()
    assert pose_error(arm.pose, ahead(arm, 0.0, 0.0))[0] < 1e-9


def test_an_interruption_stops_it(arm, controller, monkeypatch):
    def interrupted(seconds):
        raise KeyboardInterrupt

    goal = ahead(arm, 0.1)
    clock = SimpleNamespace(sleep=interrupted, monotonic=time.monotonic)
    monkeypatch.setattr(ur_arm, "time", clock)  # threads of other tests sleep on
    with pytest.raises(KeyboardInterrupt):
        arm.move_to(goal)
    assert controller.stops
    assert not controller.is_moving()


def test_an_arm_that_does_not_stop_is_said_to_move(arm, controller, monkeypatch):
    monkeypatch.setattr(ur_arm, "_STOP_TIME", 0.1)
    controller.duration, controller.begun = 60.0, time.monotonic()
    monkeypatch.setattr(type(arm._control), "stopL", lambda self, a: None)
    monkeypatch.setattr(type(controller), "halt", lambda self: None)
    with pytest.raises(RobotStoppedError, match="press its emergency stop"):
        arm.stop()
    assert controller.scripts_stopped == 1


def test_after_a_stop_its_program_is_started_again(arm, controller):
    controller.is_program_running = False
    arm.move_to(ahead(arm))
    assert controller.is_program_running


def test_closing_ends_the_program(arm, controller):
    arm.close()
    assert controller.scripts_stopped == 1
    assert not controller.is_connected


@pytest.mark.parametrize("options", ["speed=0", "speed=5", "acceleration=-1", "x=1", "force=nan"])
def test_options_of_no_sense_are_refused(controller, options):
    with pytest.raises(InvalidInputError):
        open_robot(f"ur:192.0.2.7?{options}")


def test_a_pose_that_is_none_moves_nothing(arm, controller):
    with pytest.raises(InvalidInputError):
        arm.move_to(np.ones((4, 4)))
    assert controller.duration == 0


def test_an_arm_that_is_not_there_says_so():
    pytest.importorskip("rtde_control")
    with pytest.raises(RobotFaultError, match=r"'127\.0\.0\.1' cannot be reached"):
        open_robot("ur:127.0.0.1")


def test_without_the_library_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "rtde_control", None)
    with pytest.raises(ServoscopeError, match=r"pip install \"servoscope\[ur\]\""):
        open_robot("ur:192.0.2.7")


@pytest.mark.parametrize(
    ("module", "kind"),
    [("rtde_control", RTDEControlInterface), ("rtde_receive", RTDEReceiveInterface)],
)
def test_the_stand_in_has_the_methods_of_the_library(module, kind):
    real = getattr(pytest.importorskip(module), kind.__name__)
    for method, function in inspect.getmembers(kind, inspect.isfunction):
        said = getattr(real, method).__doc__
        for parameter in list(inspect.signature(function).parameters)[1:]:
            assert f"{parameter}: " in said or f"Parameter ``{parameter}``:" in said
