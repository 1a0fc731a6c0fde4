"""A robot of one's own takes images; whatever stops it, nothing is lost."""

import signal

import numpy as np
import pytest

from planar import PIVOT, RANGES
from planar_cell import T_WORLD_REF, Cell
from servoscope import acquire_from
from servoscope.acquisition.recording import RecordingConfig, preview
from servoscope.data import folder as dataset_folder
from servoscope.data.images import PoseImageSet
from servoscope.errors import (
    AcquisitionStoppedError,
    FolderExistsError,
    InvalidInputError,
    RobotFaultError,
)
from servoscope.poses import is_rigid, pose_error
from servoscope.positioning.workspace import Workspace
from servoscope.robots.registry import make_robot
from servoscope.scene.scene import Scene

SMALL = {"translation_mm": 10.0, "rotation_deg": 4.0, "n_reference_images": 4, "settle_s": 0.2}


class Driver(Cell):
    """A driver that says that it is exactly where it was sent, with its rounding of rotations."""

    def __init__(self, stops_at: int | None = None, error: type[Exception] = RuntimeError) -> None:
        super().__init__(np.zeros(6), noise=1.0)
        self.n_sent, self.n_stopped = 0, 0
        self.stops_at, self.error = stops_at, error
        self.move = None
        del self.move

    def __getattribute__(self, name: str):
        if name == "move":
            raise AttributeError(name)
        return super().__getattribute__(name)

    def move_to(self, pose: np.ndarray) -> None:
        assert is_rigid(pose, 1e-9)
        self.n_sent += 1
        if self.n_sent == self.stops_at:
            raise self.error("protective stop")
        self.poses.append(pose + np.diag([1e-5, -1e-5, 1e-5, 0]))

    def stop(self) -> None:
        self.n_stopped += 1


def assert_same(a: PoseImageSet, b: PoseImageSet) -> None:
    np.testing.assert_allclose(a.T_world_cam, b.T_world_cam, atol=1e-4)
    assert a.names == b.names


def test_images_are_those_of_the_poses_and_the_robot_ends_at_the_reference(tmp_path) -> None:
    robot, seen = Driver(), []
    data = acquire_from(
        robot, robot, tmp_path / "part", n_images=25, on_progress=seen.append, **SMALL
    )
    assert seen == list(range(1, 26))
    assert is_rigid(data.T_world_cam, 1e-9)
    assert pose_error(T_WORLD_REF, robot.pose)[0] < 1e-9
    assert robot.n_stopped == 1
    for image, delta_p in zip(data.images, data.delta_p(), strict=True):
        expected = Cell(delta_p).read().astype(float)
        assert np.sqrt(np.mean((image - expected) ** 2)) < 2.0
    limits = 1.6 * RecordingConfig(**SMALL).ranges
    assert (np.abs(data.delta_p()).max(axis=0) < 1.001 * limits).all()
    assert data.image_noise == pytest.approx(1.04, rel=0.1)
    assert not {"part", "robot"} & data.source.keys()
    assert PoseImageSet.load(tmp_path / "part").names == data.names


def test_a_driver_that_stops_at_move_150_loses_nothing_and_goes_on(tmp_path) -> None:
    settings = {**SMALL, "n_images": 60, "max_step_mm": 4.0}
    robot = Driver(stops_at=150)
    with pytest.raises(AcquisitionStoppedError) as stopped:
        acquire_from(robot, robot, tmp_path / "part", **settings)
    message = str(stopped.value)
    assert "protective stop" in message
    assert "images are on disk" in message
    assert "mm and" in message
    assert "\n" not in message
    n_done = int(message.split(" of 60 images")[0].split()[-1])
    assert 10 < n_done < 60
    assert (robot.n_sent, robot.n_stopped) == (150, 1)  # it is not moved again
    seen: list[int] = []
    data = acquire_from(robot, robot, tmp_path / "part", on_progress=seen.append, **settings)
    assert seen[0] == n_done + 1
    assert len(data) == 59
    (refused,) = data.source["refused"]
    names = [f"{i:06d}" for i in range(60) if i != refused]
    assert list(data.names) == names
    drawn = preview(Driver(), RecordingConfig(**settings)).poses
    np.testing.assert_allclose(data.T_world_cam, np.delete(drawn, refused, axis=0), atol=1e-4)
    assert pose_error(T_WORLD_REF, robot.pose)[0] < 1e-9


def test_a_pose_that_the_robot_cannot_reach_is_left_out(tmp_path) -> None:
    class Short(Driver):
        def move_to(self, pose: np.ndarray) -> None:
            if pose[0, 3] > T_WORLD_REF[0, 3] + 0.055:
                raise RobotFaultError("out of reach")
            super().move_to(pose)

    robot, said = Short(), []
    data = acquire_from(
        robot, robot, tmp_path / "part", n_images=30, on_message=said.append, **SMALL
    )
    assert 1 <= len(data.source["refused"]) == 30 - len(data) <= 6
    assert "out of reach" in said[0]


def test_ctrl_c_stops_the_robot_and_the_same_call_goes_on(tmp_path) -> None:
    robot = Driver(stops_at=20, error=KeyboardInterrupt)
    with pytest.raises(AcquisitionStoppedError, match=r"^Interrupted\. It was stopped"):
        acquire_from(robot, robot, tmp_path / "part", n_images=20, **SMALL)
    assert (robot.n_sent, robot.n_stopped) == (20, 1)
    assert len(acquire_from(robot, robot, tmp_path / "part", n_images=20, **SMALL)) == 20


def test_a_part_that_was_moved_is_noticed_and_images_since_then_are_taken_again(tmp_path) -> None:
    class Pushed(Driver):
        is_pushed = False

        @property
        def delta_p(self):
            return super().delta_p + self.is_pushed * np.array([0.004, 0, 0, 0, 0, 0])

    robot = Pushed()

    def push(n_done: int) -> None:
        robot.is_pushed = n_done >= 15

    settings = {**SMALL, "n_images": 30, "check_every": 10}
    with pytest.raises(
        AcquisitionStoppedError, match=r"changed between image 10 and image 20.*10 of 30 images"
    ):
        acquire_from(robot, robot, tmp_path / "part", on_progress=push, **settings)
    assert pose_error(T_WORLD_REF, robot.pose)[0] < 1e-9
    with pytest.raises(AcquisitionStoppedError, match="changed"):  # it is still there
        acquire_from(robot, robot, tmp_path / "part", **settings)
    robot.is_pushed = False
    data = acquire_from(robot, robot, tmp_path / "part", **settings)
    for image, delta_p in zip(data.images, data.delta_p(), strict=True):
        assert np.sqrt(np.mean((image - Cell(delta_p).read().astype(float)) ** 2)) < 2.0


def test_a_lamp_that_fades_is_said(tmp_path) -> None:
    class Fading(Driver):
        gain = 1.0

        def read(self):
            return np.rint(self.gain * super().read()).astype(np.uint8)

    robot, said = Fading(), []

    def fade(n_done: int) -> None:
        robot.gain = 1 - 0.012 * n_done

    settings = {**SMALL, "n_images": 20, "check_every": 10}
    acquire_from(
        robot, robot, tmp_path / "part", on_progress=fade, on_message=said.append, **settings
    )
    assert said == [
        "The light has changed by -12% between image 0 and image 10.",
        "The light has changed by -24% between image 10 and image 20.",
    ]


@pytest.mark.parametrize(
    ("image", "reason"),
    [(np.zeros((48, 48), np.uint8), "black"), (np.full((48, 48), 255, np.uint8), "saturated")],
)
def test_a_camera_that_fails_ends_it_at_the_reference(tmp_path, image, reason) -> None:
    class Failing(Driver):
        def read(self):
            return image if self.n_sent > 10 else super().read()

    robot = Failing()
    with pytest.raises(
        AcquisitionStoppedError, match=f"{reason}.*The robot is back at the reference"
    ):
        acquire_from(robot, robot, tmp_path / "part", n_images=20, **SMALL)
    assert pose_error(T_WORLD_REF, robot.pose)[0] < 1e-9


def test_ctrl_c_on_the_way_back_after_a_fault_stops_the_robot_there(tmp_path) -> None:
    class Failing(Driver):
        is_black, n_back = False, 0

        def read(self):
            self.is_black = self.n_sent > 10
            return np.zeros((48, 48), np.uint8) if self.is_black else super().read()

        def move_to(self, pose):
            super().move_to(pose)
            if self.is_black:
                self.n_back += 1
                signal.raise_signal(signal.SIGINT)

    robot = Failing()
    with pytest.raises(AcquisitionStoppedError, match=r"^Interrupted on the way back.*black"):
        acquire_from(robot, robot, tmp_path / "part", n_images=20, **SMALL)
    assert (robot.n_back, robot.n_stopped) == (1, 1)


def test_ctrl_c_names_no_fault_that_was_dealt_with_before(tmp_path) -> None:
    def interrupted(n_done: int) -> None:
        try:
            raise TimeoutError("the display is busy")
        except OSError:
            if n_done == 5:
                signal.raise_signal(signal.SIGINT)

    robot = Driver()
    with pytest.raises(AcquisitionStoppedError) as caught:
        acquire_from(robot, robot, tmp_path / "part", n_images=20, on_progress=interrupted, **SMALL)
    assert str(caught.value).startswith("Interrupted. ")
    assert "busy" not in str(caught.value)


def test_a_robot_stays_after_ctrl_c_that_became_another_error(tmp_path) -> None:
    def closes(n_done: int) -> None:
        if n_done == 5:
            try:
                signal.raise_signal(signal.SIGINT)
            except KeyboardInterrupt as error:
                at.append(robot.n_sent)
                raise OSError("the pipe is closed") from error

    robot, at = Driver(), []
    with pytest.raises(AcquisitionStoppedError, match=r"^Interrupted\. It was stopped"):
        acquire_from(robot, robot, tmp_path / "part", n_images=20, on_progress=closes, **SMALL)
    assert (robot.n_sent, robot.n_stopped) == (at[0], 1)


def test_a_frozen_camera_and_one_that_never_rests_are_refused(tmp_path) -> None:
    class Frozen(Driver):
        def read(self):
            return Cell(np.zeros(6)).read()

    class Shaken(Driver):
        def read(self):
            self.shaken = np.random.default_rng(self.n_sent).normal(size=6)
            self.n_sent += 1
            return Cell(0.2 * RANGES * self.shaken).read()

    for robot, reason in ((Frozen(), "frozen"), (Shaken(), "not come to rest")):
        with pytest.raises(AcquisitionStoppedError, match=reason):
            acquire_from(robot, robot, tmp_path / reason[:6], n_images=20, **SMALL)


def test_images_that_a_camera_keeps_back_are_not_taken_for_new_ones(tmp_path) -> None:
    class Late(Driver):
        def __init__(self):
            super().__init__()
            self.kept = []

        def move_to(self, pose):
            self.kept = [super(Late, self).read() for _ in range(3)]  # of before the move
            super().move_to(pose)

        def read(self):
            return self.kept.pop(0) if self.kept else super().read()

    robot, late = Late(), {**SMALL, "settle_s": 2.0, "max_step_mm": 500.0, "max_step_deg": 90.0}
    data = acquire_from(robot, robot, tmp_path / "part", n_images=12, **late)
    for image, delta_p in zip(data.images, data.delta_p(), strict=True):
        assert np.sqrt(np.mean((image - Cell(delta_p).read().astype(float)) ** 2)) < 2.0


def test_a_reference_that_shows_nothing_is_refused(tmp_path) -> None:
    class Dark(Driver):
        def read(self):
            return np.zeros((48, 48), np.uint8)

    robot = Dark()
    with pytest.raises(InvalidInputError, match="must show something"):
        acquire_from(robot, robot, tmp_path / "part", **SMALL)
    assert robot.n_sent == 0


def test_a_view_that_swings_is_waited_for(tmp_path) -> None:
    class Swinging(Driver):
        swing = 0.0

        def move_to(self, pose):
            super().move_to(pose)
            self.swing = 1.0

        @property
        def delta_p(self):
            return super().delta_p + self.swing * 0.1 * RANGES

        def read(self):
            image = super().read()
            self.swing = 0.0 if self.swing < 0.2 else 0.5 * self.swing
            return image

    robot = Swinging()
    data = acquire_from(robot, robot, tmp_path / "part", n_images=15, **{**SMALL, "settle_s": 5.0})
    for image, delta_p in zip(data.images, data.delta_p(), strict=True):
        assert np.sqrt(np.mean((image - Cell(delta_p).read().astype(float)) ** 2)) < 2.5


@pytest.mark.parametrize("step", ["keep_reference", "keep_image", "write_progress"])
@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_a_stop_while_writing_costs_nothing_that_is_there(
    tmp_path, monkeypatch, step, error
) -> None:
    write, n_written = getattr(dataset_folder, step), 0

    def fail(*arguments):
        nonlocal n_written
        n_written += 1
        if n_written == (1 if step == "keep_reference" else 4):
            raise error
        write(*arguments)

    robot = Driver()
    with monkeypatch.context() as patch:
        patch.setattr(dataset_folder, step, fail)
        with pytest.raises(AcquisitionStoppedError) as stopped:
            acquire_from(robot, robot, tmp_path / "part", n_images=8, **SMALL)
    assert ("No space left" in str(stopped.value)) == isinstance(error, OSError)
    if isinstance(error, OSError):
        assert pose_error(T_WORLD_REF, robot.pose)[0] < 1e-9
    data = acquire_from(robot, robot, tmp_path / "part", n_images=8, **SMALL)
    assert list(data.names) == [f"{i:06d}" for i in range(8)]
    for image, delta_p in zip(data.images, data.delta_p(), strict=True):
        assert np.sqrt(np.mean((image - Cell(delta_p).read().astype(float)) ** 2)) < 2.0


def test_nothing_moves_without_consent_or_out_of_the_workspace(tmp_path) -> None:
    robot = Driver()
    with pytest.raises(AcquisitionStoppedError, match="Nothing was moved"):
        acquire_from(robot, robot, tmp_path / "part", confirm=lambda plan: False, **SMALL)
    x, y, z = 1e3 * T_WORLD_REF[:3, 3]
    box = Workspace.parse(f"x={x - 10}:{x + 10},y={y - 10}:{y + 10},z={z - 10}:{z + 10}")
    assert robot.n_sent == 0
    acquire_from(robot, robot, tmp_path / "part", n_images=10, workspace=box, **SMALL)
    assert box.holds(np.array(robot.poses))
    data = PoseImageSet.load(tmp_path / "part")
    assert Workspace.of_source(data.source) == box
    assert (data.ranges() <= np.abs(data.delta_p()).max(axis=0) * 1.001).all()
    robot.poses.append(robot.poses[-1] + np.diag([0, 0, 0, 0.0]))
    robot.poses[-1][0, 3] += 0.05
    with pytest.raises(AcquisitionStoppedError, match="outside the workspace"):
        acquire_from(robot, robot, tmp_path / "other", n_images=10, workspace=box, **SMALL)


def test_a_folder_is_not_replaced_unless_it_is_asked_for(tmp_path) -> None:
    robot = Driver()
    first = acquire_from(robot, robot, tmp_path / "part", n_images=5, **SMALL)
    n_sent = robot.n_sent
    again = acquire_from(robot, robot, tmp_path / "part", n_images=5, **SMALL)
    np.testing.assert_array_equal(first.images, again.images)
    assert robot.n_sent == n_sent
    with pytest.raises(FolderExistsError, match="--force"):
        acquire_from(robot, robot, tmp_path / "part", n_images=6, **SMALL)
    assert len(acquire_from(robot, robot, tmp_path / "part", n_images=6, force=True, **SMALL)) == 6


def test_colour_images_and_settings_that_are_none_are_refused(tmp_path) -> None:
    class Colour(Driver):
        def read(self):
            return np.dstack([super().read()] * 3)

    robot = Colour()
    with pytest.raises(AcquisitionStoppedError, match="grey images"):
        acquire_from(robot, robot, tmp_path / "part", **SMALL)
    for wrong in ({"translation_mm": -1}, {"check_every": 0}, {"n_images": 0}, {"dofs": ["w"]}):
        with pytest.raises(InvalidInputError):
            RecordingConfig(**wrong)


def test_the_simulated_arm_goes_the_same_way(tmp_path) -> None:
    arm = make_robot("arm", Scene(image_size=48))
    start = arm.pose
    data = acquire_from(arm, arm, tmp_path / "part", n_images=8, **{**SMALL, "max_step_deg": 30.0})
    assert len(data) == 8
    assert data.pivot == PIVOT
    assert pose_error(start, arm.pose)[0] < 1e-4
