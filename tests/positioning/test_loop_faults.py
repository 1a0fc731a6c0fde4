"""Whatever the camera, the robot or the estimator do wrong: a status, one line, and no motion."""

import os
import re
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.linalg import expm, logm

from planar import RANGES, planar_images
from planar_cell import SIZE, Cell, Oracle
from servoscope.poses import rigid_transform
from servoscope.positioning.interfaces import Estimate
from servoscope.positioning.look_and_move import Positioner
from servoscope.positioning.result import STATUSES, PositioningResult
from servoscope.positioning.settings import LoopSettings

START = 0.5 * RANGES * [1, -1, 1, -1, 1, 1]
SHORT = LoopSettings(read_timeout_s=1, first_read_timeout_s=1, move_timeout_s=1)
UNWATCHED = LoopSettings(read_timeout_s=None, move_timeout_s=None)


def run(cell: Cell, camera=None, robot=None, oracle=None, settings=SHORT) -> PositioningResult:
    oracle = Oracle(cell, lambda p: 0.7 * p) if oracle is None else oracle
    result = Positioner(oracle, settings).run(robot or cell, camera or cell)
    assert result.status in STATUSES
    assert result.message
    assert "\n" not in result.message
    return result


class FaultyCamera:
    """The cell's camera, with ``fault(image)`` in place of the third image and those after it."""

    def __init__(self, cell: Cell, fault) -> None:
        self.cell, self.fault, self.n_read, self.poses_then = cell, fault, 0, 0

    def read(self):
        self.n_read += 1
        if self.n_read < 3:
            self.last = self.cell.read()
            return self.last
        self.poses_then = len(self.cell.poses)
        return self.fault(self)


def _raise(error: BaseException):
    raise error


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (lambda c: np.zeros((SIZE, SIZE), np.uint8), "is black: 100 % of it"),
        (lambda c: np.full((SIZE, SIZE), 255, np.uint8), "is saturated: 100 % of it"),
        (lambda c: np.full((SIZE, SIZE), 90, np.uint8), "is empty: its contrast is 0.0"),
        (lambda c: np.clip(c.cell.read() * 9.0, 0, 255).astype(np.uint8), "is saturated"),
        (
            lambda c: np.random.default_rng(0).integers(0, 14, (SIZE, SIZE), np.uint8),
            "is black: its contrast",
        ),
        (lambda c: c.last, "is frozen: not a bit of it changed while the robot moved"),
        (
            lambda c: c.cell.read()[:40],
            "takes images of 48 x 48 pixels, but the camera gave 48 x 4",
        ),
        (lambda c: cv2.cvtColor(c.cell.read(), cv2.COLOR_GRAY2BGR), "grey images"),
        (lambda c: c.cell.read() / 255, "grey images.*float64"),
        (lambda c: None, "an array, but gave a NoneType"),
        (lambda c: _raise(OSError("cable\nis out")), "The camera failed: cable is out"),
        (lambda c: _raise(OSError()), "The camera failed: OSError"),
        (lambda c: time.sleep(3), r"gave no image \(time-out after 1 s\)"),
    ],
)
def test_a_camera_that_goes_wrong_in_mid_loop_ends_the_run(fault, message: str) -> None:
    cell = Cell(START)
    camera = FaultyCamera(cell, fault)
    result = run(cell, camera=camera)
    assert result.status == "camera_fault"
    assert re.search(message, result.message)
    assert len(cell.poses) == camera.poses_then == 3
    assert (result.moves, len(result.steps)) == (2, 2)


def test_small_moves_of_a_frozen_camera_add_up() -> None:
    cell = Cell(0.02 * RANGES)
    image = cell.read()
    camera = FaultyCamera(cell, lambda c: image)
    camera.n_read = 5
    result = run(cell, camera, oracle=Oracle(cell, lambda p: 0.2 * p))
    assert result.status == "camera_fault"
    assert "frozen" in result.message
    assert 2 <= result.moves <= 6


def test_the_same_image_is_no_fault_while_the_robot_stands() -> None:
    cell = Cell(START)
    result = run(cell, oracle=Oracle(cell, lambda p: 1e-3 * p))
    assert result.status == "max_moves"


def test_bright_noisy_covered_and_dim_images_are_looked_at() -> None:
    def covered(image):
        image[: SIZE // 2, : SIZE // 2] = 255
        return image

    for change in (covered, lambda image: image // 4, lambda image: image // 2 + 127):
        cell = Cell(START)
        camera = FaultyCamera(cell, lambda c, change=change: change(c.cell.read()))
        assert run(cell, camera).status == "converged"
    cell = Cell(START, noise=10)
    assert run(cell).status == "converged"


def test_a_model_for_another_image_size_is_told_before_anything_moves() -> None:
    cell = Cell(START)
    oracle = Oracle(cell)
    oracle.image_shape = (64, 96)
    oracle.reference_image = planar_images(np.zeros((1, 6)), 96, seed=3)[0][:64]
    result = run(cell, oracle=oracle)
    assert result.status == "camera_fault"
    assert "takes images of 96 x 64 pixels, but the camera gave 48 x 48" in result.message
    assert len(cell.poses) == 1


def test_an_image_unlike_the_training_images_is_abstained_from() -> None:
    cell = Cell(START)
    result = run(cell, oracle=Oracle(cell, novelty=3.217))
    assert result.status == "abstained"
    assert "3.22 where at most 1.00 is allowed" in result.message
    assert len(cell.poses) == 1
    assert len(result.steps) == 1


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (lambda: np.full((4, 4), np.nan), "no rigid displacement"),
        (lambda: np.diag([1.0, 1.0, -1.0, 1.0]), "no rigid displacement"),
        (lambda: rigid_transform(np.eye(3), [np.inf, 0, 0]), "no rigid displacement"),
        (lambda: _raise(ZeroDivisionError("no\nway")), "failed: ZeroDivisionError: no way"),
    ],
)
def test_an_estimator_that_gives_nonsense_or_fails_is_abstained_from(answer, message) -> None:
    class Broken(Oracle):
        def estimate(self, image, previous):
            return Estimate(answer(), self.std, np.nan, "broken")

    cell = Cell(START)
    result = run(cell, oracle=Broken(cell))
    assert result.status == "abstained"
    assert message in result.message
    assert len(cell.poses) == 1


def test_a_limit_that_is_no_number_lets_nothing_pass() -> None:
    class Unlimited(Oracle):
        def estimate(self, image, previous):
            found = super().estimate(image, previous)
            return replace(found, similarity=0.1, least_similarity=np.nan)

    cell = Cell(START)
    result = run(cell, oracle=Unlimited(cell))
    assert result.status == "abstained"
    assert "least_similarity as a number, but gave nan" in result.message
    assert len(cell.poses) == 1


class FaultyRobot:
    """The cell's robot, with ``fault(cell, displacement)`` as its second move."""

    def __init__(self, cell: Cell, fault) -> None:
        self.cell, self.fault, self.n_asked, self.stops = cell, fault, 0, 0

    @property
    def pose(self):
        return self.cell.pose

    def move(self, displacement):
        self.n_asked += 1
        if self.n_asked == 2:
            return self.fault(self.cell, displacement)
        return self.cell.move(displacement)

    def stop(self):
        self.stops += 1


def half(displacement: np.ndarray) -> np.ndarray:
    return expm(0.5 * logm(displacement)).real


def _lies(cell: Cell, displacement: np.ndarray) -> np.ndarray:
    cell.move(half(displacement))
    return displacement


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (lambda cell, D: cell.move(half(D)), "was to move .* and moved"),
        (_lies, "was to move .* and moved"),
        (lambda cell, D: half(cell.move(D)), "was to move .* and moved"),
        (lambda cell, D: np.eye(4), "and moved 0.00 mm and 0.000 deg"),
        (lambda cell, D: _raise(RuntimeError("joint 3\nat its limit")), "joint 3 at its limit"),
        (lambda cell, D: cell.move(D) * np.nan, "finite rigid .* nan"),
        (lambda cell, D: 2 * cell.move(D), "finite rigid"),
        (lambda cell, D: cell.poses.append(cell.pose * np.nan) or D, "report its pose as a finite"),
        (lambda cell, D: None, "reported None"),
        (lambda cell, D: time.sleep(3), "time-out after 1 s"),
    ],
)
def test_a_robot_that_goes_wrong_ends_the_run_and_is_stopped(fault, message: str) -> None:
    cell = Cell(START)
    robot = FaultyRobot(cell, fault)
    result = run(cell, robot=robot)
    assert result.status == "robot_fault"
    assert re.search(message, result.message)
    assert (robot.n_asked, robot.stops, result.moves) == (2, 1, 1)
    assert np.isnan(result.remaining).all()


@pytest.mark.parametrize(
    "pose", [np.full((4, 4), np.nan), np.diag([1.0, 1, -1, 1]), None, np.eye(3)]
)
def test_a_robot_that_does_not_know_where_it_is_does_not_move(pose) -> None:
    class Lost:
        n_moves = 0

        def __init__(self) -> None:
            self.pose = pose

        def move(self, displacement):
            self.n_moves += 1

    robot = Lost()
    result = run(Cell(START), robot=robot)
    assert (result.status, robot.n_moves) == ("robot_fault", 0)


def test_a_robot_fault_on_the_way_back_is_a_robot_fault() -> None:
    cell = Cell(0.3 * START)
    unjudged = replace(SHORT, largest_innovation=None)
    oracle = Oracle(cell, lambda p: -0.5 * p)
    robot = FaultyRobot(cell, lambda cell, D: cell.move(D))
    assert run(cell, robot=robot, oracle=oracle, settings=unjudged).status == "diverged"
    n_moves = robot.n_asked
    cell.poses[1:] = []
    robot = FaultyRobot(cell, None)
    robot.move = lambda D: cell.move(D if len(cell.poses) < n_moves else half(D))
    assert run(cell, robot=robot, oracle=oracle, settings=unjudged).status == "robot_fault"
    assert len(cell.poses) == n_moves + 1


@pytest.mark.parametrize("where", ["camera", "robot", "on_step"])
def test_ctrl_c_stops_the_robot_and_still_gives_a_result(where: str) -> None:
    cell = Cell(START)
    robot = FaultyRobot(cell, lambda cell, D: _raise(KeyboardInterrupt()))
    if where != "robot":
        robot.fault = Cell.move
    camera = FaultyCamera(cell, lambda c: _raise(KeyboardInterrupt()))
    if where != "camera":
        camera.n_read = -100

    def on_step(step, image):
        if where == "on_step" and len(cell.poses) == 2:
            raise KeyboardInterrupt

    result = Positioner(Oracle(cell, lambda p: 0.7 * p), SHORT).run(robot, camera, on_step=on_step)
    assert (result.status, robot.stops) == ("interrupted", 1)
    assert result.message == "Interrupted by the user. It was stopped."
    assert len(result.steps) == 2
    assert np.isnan(result.remaining).all() == (where == "robot")


def test_ctrl_c_is_heard_while_a_device_is_waited_for() -> None:
    cell = Cell(START)
    robot = FaultyRobot(cell, lambda cell, D: time.sleep(2))
    robot.n_asked = 1
    timer = threading.Timer(0.3, lambda: __import__("_thread").interrupt_main())
    timer.start()
    start = time.perf_counter()
    result = run(cell, robot=robot, settings=LoopSettings())
    assert result.status == "interrupted"
    assert time.perf_counter() - start < 1.9
    assert robot.stops == 1


def test_without_a_time_out_everything_runs_in_the_thread_of_the_caller() -> None:
    cell, threads = Cell(START), set()

    class Camera:
        def read(self):
            threads.add(threading.current_thread())
            return cell.read()

    run(cell, camera=Camera(), settings=LoopSettings(read_timeout_s=None, move_timeout_s=None))
    assert threads == {threading.main_thread()}


def test_a_robot_without_stop_or_with_a_broken_one_is_told_of() -> None:
    cell = Cell(START)
    cell.move = lambda D: _raise(RuntimeError("no"))
    assert "offers no stop(), and may still be moving" in run(cell).message
    cell.stop = lambda: _raise(RuntimeError("nor this"))
    assert "stop() failed: nor this" in run(cell).message


class Unprintable(Exception):
    """Its text cannot be had."""

    def __str__(self) -> str:
        raise ValueError("no text")


ENDS = (SystemExit(3), GeneratorExit(), Unprintable(), MemoryError())


@pytest.mark.parametrize("end", ENDS, ids=lambda end: type(end).__name__)
@pytest.mark.parametrize(
    ("where", "status"),
    [
        ("read", "camera_fault"),
        ("move", "robot_fault"),
        ("pose", "robot_fault"),
        ("estimate", "abstained"),
        ("on_step", "callback_fault"),
    ],
)
@pytest.mark.parametrize("settings", [SHORT, UNWATCHED], ids=["watched", "unwatched"])
def test_whatever_is_raised_ends_in_a_status_with_the_robot_stopped(
    end, where: str, status: str, settings: LoopSettings
) -> None:
    class Failing(Cell):
        stops = 0

        @property
        def pose(self):
            return fail("pose", self.poses[-1])

        def read(self):
            return fail("read", super().read())

        def move(self, displacement):
            return fail("move", super().move(displacement))

        def stop(self):
            self.stops += 1

    class FailingOracle(Oracle):
        def estimate(self, image, previous):
            return fail("estimate", super().estimate(image, previous))

    def fail(place, value):
        if place == where and len(cell.poses) >= 2:
            raise end
        return value

    cell = Failing(START)
    result = Positioner(FailingOracle(cell, lambda p: 0.7 * p), settings).run(
        cell, cell, on_step=lambda step, image: fail("on_step", None)
    )
    assert (result.status, cell.stops) == (status, 1)
    assert type(end).__name__ in result.message or str(end.args[0]) in result.message
    assert len(cell.poses) == 2


@pytest.mark.parametrize("answer", [None, np.eye(4), "near"])
def test_an_estimator_that_returns_no_estimate_is_abstained_from(answer) -> None:
    class Wrong(Oracle):
        def estimate(self, image, previous):
            return answer

    cell = Cell(START)
    result = run(cell, oracle=Wrong(cell))
    assert result.status == "abstained"
    assert "must return an Estimate" in result.message
    assert len(cell.poses) == 1


def test_text_of_a_driver_reaches_no_terminal_with_control_characters() -> None:
    cell = Cell(START)
    cell.move = lambda D: _raise(RuntimeError("\x1b]0;owned\x07 joint 3"))
    message = run(cell).message
    assert "joint 3" in message
    assert message.isprintable()


def test_a_robot_that_is_carried_away_after_the_image_is_not_commanded() -> None:
    class Carried(Cell):
        def read(self):
            image = super().read()
            self.poses[-1] = self.poses[-1] @ rigid_transform(np.eye(3), [0, 0.002, 0])
            return image

    cell = Carried(START)
    result = run(cell)
    assert (result.status, len(cell.poses)) == ("robot_fault", 1)
    assert "was moved 2.00 mm" in result.message
    assert np.isnan(result.remaining).all()


def test_a_robot_that_is_carried_away_by_the_callback_is_not_commanded() -> None:
    cell = Cell(START)

    def on_step(step, image):
        cell.poses[-1] = cell.poses[-1] @ rigid_transform(np.eye(3), [0, 0.002, 0])

    result = Positioner(Oracle(cell), SHORT).run(cell, cell, on_step=on_step)
    assert (result.status, len(cell.poses)) == ("robot_fault", 1)


def test_a_robot_that_is_carried_away_from_the_reference_has_not_arrived() -> None:
    class Carried(Cell):
        def read(self):
            image = super().read()
            if len(self.poses) == 2:
                self.poses[-1] = self.poses[-1] @ rigid_transform(np.eye(3), [0, 0.002, 0])
            return image

    cell = Carried(START)
    assert run(cell, oracle=Oracle(cell)).status == "robot_fault"


def test_the_encoder_may_tremble_while_the_robot_stands() -> None:
    class Trembling(Cell):
        @property
        def pose(self):
            return self.poses[-1] @ rigid_transform(np.eye(3), self.rng.normal(0, 1e-5, 3))

    cell = Trembling(START)
    assert run(cell).status == "converged"


@pytest.mark.parametrize("status", ["converged", "max_moves", "abstained"])
def test_the_robot_is_stopped_however_a_run_ends(status: str) -> None:
    cell = Cell(START)
    cell.stops = 0

    def stop():
        cell.stops += 1

    cell.stop = stop
    settings = replace(SHORT, max_moves=1 if status == "max_moves" else 12)
    oracle = Oracle(cell, lambda p: 0.7 * p, novelty=3 if status == "abstained" else np.nan)
    assert run(cell, oracle=oracle, settings=settings).status == status
    assert cell.stops == 1


def test_a_dry_run_does_not_stop_a_robot_that_it_never_moved() -> None:
    cell = Cell(START)
    cell.stop = lambda: _raise(AssertionError("stopped"))
    result = Positioner(Oracle(cell), SHORT).run(cell, cell, dry_run=True)
    assert result.status == "dry_run"


CHILD = """
import sys, time
sys.path.insert(0, sys.argv[1])
from planar import RANGES
from planar_cell import Cell, Oracle
from servoscope.positioning import Positioner

class Slow(Cell):
    def move(self, displacement):
        print("moving", flush=True)
        time.sleep(30)

    def stop(self):
        print("stopping", flush=True)
        time.sleep(1)
        print("stopped", flush=True)

cell = Slow(0.5 * RANGES)
print(Positioner(Oracle(cell)).run(cell, cell).status, flush=True)
"""


@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
@pytest.mark.parametrize("first", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_second_signal_does_not_cut_stop_short(first: str) -> None:
    here = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    said = []
    with subprocess.Popen(
        [sys.executable, "-c", CHILD, here], stdout=subprocess.PIPE, text=True
    ) as child:
        for line in child.stdout:
            said.append(line.strip())
            if said[-1] == "moving":
                child.send_signal(getattr(signal, first))
            if said[-1] == "stopping":
                time.sleep(0.2)
                child.send_signal(signal.SIGINT)
                child.send_signal(signal.SIGTERM)
    assert child.returncode == 0
    assert said == ["moving", "stopping", "stopped", "interrupted"]


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_an_interruption_that_a_driver_makes_its_own_error_of_is_one(name: str) -> None:
    cell = Cell(START)

    def move(displacement):
        try:
            signal.raise_signal(getattr(signal, name))
        except KeyboardInterrupt as error:
            raise RuntimeError("the socket was closed") from error

    cell.move = move
    ended = run(cell, settings=replace(SHORT, move_timeout_s=None))
    assert ended.status == "interrupted"
    by_whom = "the user" if name == "SIGINT" else name
    assert ended.message.startswith(f"Interrupted by {by_whom}. The robot did not move: the socket")


def test_the_first_image_may_take_longer_than_the_others() -> None:
    cell = Cell(START)
    camera = FaultyCamera(cell, lambda c: c.cell.read())
    read = camera.read

    def slow_at_first():
        if camera.n_read == 0:
            time.sleep(0.3)
        return read()

    camera.read = slow_at_first
    settings = LoopSettings(read_timeout_s=0.2, first_read_timeout_s=5)
    assert run(cell, camera, settings=settings).status == "converged"
    settings = LoopSettings(read_timeout_s=0.2, first_read_timeout_s=0.1)
    camera.n_read = 0
    assert run(Cell(START), camera, settings=settings).status == "camera_fault"


def test_looks_that_lead_to_no_decision_end_in_time(monkeypatch):
    monkeypatch.setattr("servoscope.positioning.run.Run._decision", lambda self: None)
    result = run(Cell(START))
    assert (result.status, result.moves, len(result.steps)) == ("abstained", 0, 10)
    assert "10 looks from one pose led to no decision" in result.message
