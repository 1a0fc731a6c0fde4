"""The plan is seen before a robot moves; the robot takes images when a person says so."""

import json
import signal
import sys
import threading
import time

import numpy as np
import pytest

from planar_cell import T_WORLD_REF, Stoppable
from servoscope import acquire_from
from servoscope.acquisition.recording import RecordingConfig
from servoscope.cli import main
from servoscope.errors import AcquisitionStoppedError
from servoscope.poses import pose_error
from servoscope.positioning.workspace import Workspace
from servoscope.viewer.acquisition import LiveAcquisition, planned
from servoscope.viewer.way import COLOURS, Way

SMALL = {
    "n_images": 5, "translation_mm": 10.0, "rotation_deg": 4.0, "n_reference_images": 2,
    "settle_s": 0.2, "check_every": 3,
}  # fmt: skip


def driver(seconds: float = 0.0) -> Stoppable:
    return Stoppable(np.zeros(6), noise=1.0, seconds=seconds)


class Page:
    """A page that keeps what it is to show, and presses a button whenever the robot waits."""

    def __init__(self, *presses) -> None:
        self.presses, self.said, self.marked, self.shown = list(presses), [], [], []
        self.allowed = None

    def __call__(self, history):
        self.history = history
        return self

    def command(self, player) -> None:
        self.player = player

    def say(self, words: str) -> None:
        self.said.append(words)
        if "press Step or Run" in words:
            self.presses.pop(0)(self.player)

    def show(self, k: int) -> None:
        self.shown.append(k)

    def mark(self, taken, refused) -> None:
        self.marked.append((taken, refused))

    def allow(self, *, step: bool, run: bool) -> None:
        self.allowed = (step, run)


def taken(folder, robot, page, **options):
    live = LiveAcquisition(robot, page, **options)
    return live, acquire_from(
        live.robot, robot, folder, confirm=live.confirm, on_shot=live.on_shot,
        on_message=live.on_message, **SMALL,
    )  # fmt: skip


def test_the_plan_is_shown_before_anything_moves(tmp_path) -> None:
    robot, seen = driver(), []

    def look(live) -> None:
        seen.append((robot.sent, page.said[-1], len(page.history.looks)))
        live.run()

    page = Page(look)
    _, data = taken(tmp_path / "part", robot, page)
    ((sent, words, n_looks),) = seen
    assert sent == 0
    assert n_looks == 1
    assert str(page.history.way.plan) in words
    assert len(data) == 5


def test_every_image_is_shown_where_it_was_taken_with_what_is_done(tmp_path) -> None:
    page = Page(LiveAcquisition.run)
    _, data = taken(tmp_path / "part", driver(), page)
    history = page.history
    np.testing.assert_array_equal(history.setting.reference_image, data.reference_image)
    order = [marks[0][-1] for marks in page.marked if marks[0]]
    assert sorted(set(order)) == list(range(5))
    images = [look for look in history.looks if np.abs(look.displacement).max() > 1e-6]
    assert len(images) == 5
    by_number = [images[sorted(set(order), key=order.index).index(i)] for i in range(5)]
    for look, image, delta_p in zip(by_number, data.images, data.delta_p(), strict=True):
        np.testing.assert_array_equal(look.image, image)
        np.testing.assert_allclose(look.displacement[:3], 1e3 * delta_p[:3], atol=0.1)
    following = [look.next_camera for look in history.looks]
    assert following[-1] is None
    np.testing.assert_allclose(following[0], images[0].camera, atol=1e-6)
    progress = [words for words in page.said if "of 5 images are on disk" in words]
    assert "left" in progress[0]
    assert "5 of 5" in progress[-1]
    assert any("as sharp" in words and "as bright" in words for words in page.said)
    assert any("of it match" in words for words in page.said)


def test_a_step_is_one_image(tmp_path) -> None:
    robot, at = driver(), []

    def step(live) -> None:
        at.append(len(page.marked[-1][0]))
        live.step()

    def run(live) -> None:
        at.append(len(page.marked[-1][0]))
        live.run()

    page = Page(step, step, run)
    taken(tmp_path / "part", robot, page)
    assert at == [0, 1, 2]


def test_stop_before_the_first_move_moves_nothing(tmp_path) -> None:
    robot, page = driver(), Page(LiveAcquisition.stop)
    with pytest.raises(AcquisitionStoppedError, match="0 of 5"):
        taken(tmp_path / "part", robot, page)
    assert (robot.sent, robot.stops) == (0, 1)


def test_stop_within_a_move_stops_the_robot_and_the_same_command_goes_on(tmp_path) -> None:
    robot = driver(seconds=0.0)

    def stop_on_the_way(live) -> None:
        def press() -> None:
            robot.is_moving.wait(5)
            live.stop()

        robot.seconds = 20.0
        robot.is_moving.clear()
        threading.Thread(target=press).start()
        live.run()

    page = Page(LiveAcquisition.step, stop_on_the_way)
    with pytest.raises(AcquisitionStoppedError, match="1 of 5 images are on disk"):
        taken(tmp_path / "part", robot, page)
    assert robot.stops >= 1  # twice where the machine is slow
    again = driver()
    page = Page(LiveAcquisition.run)
    _, data = taken(tmp_path / "part", again, page)
    assert page.marked[0][0] != ()
    assert len(data) == 5


def test_stop_is_heard_on_the_way_back_after_a_fault(tmp_path) -> None:
    robot = driver()

    def fail() -> np.ndarray:
        robot.seconds = 20.0
        robot.is_moving.clear()
        threading.Thread(target=press).start()
        raise OSError("unplugged")

    def press() -> None:
        robot.is_moving.wait(5)
        page.player.stop()

    def break_the_camera(live) -> None:
        robot.read = fail
        live.run()

    page = Page(LiveAcquisition.step, break_the_camera)
    start = time.monotonic()
    with pytest.raises(AcquisitionStoppedError, match="unplugged"):
        taken(tmp_path / "part", robot, page)
    assert time.monotonic() - start < 10
    assert robot.stops >= 1
    assert pose_error(T_WORLD_REF, robot.pose)[0] > 1e-3


def test_after_the_end_stop_stops_the_robot_itself_and_nothing_moves(tmp_path) -> None:
    robot, page = driver(), Page(LiveAcquisition.run)
    live, _ = taken(tmp_path / "part", robot, page)
    live.finish("done")
    sent, stops = robot.sent, robot.stops
    live.run()
    live.step()
    live.stop()
    assert (robot.sent, robot.stops) == (sent, stops + 1)
    assert page.allowed == (False, False)
    live.seek(99)
    assert page.shown[-1] == len(page.history.looks) - 1


def test_what_was_agreed_before_needs_no_button(tmp_path) -> None:
    page = Page()
    taken(tmp_path / "part", driver(), page, is_agreed=True)
    assert not any("press" in words for words in page.said)


BOX = Workspace.parse("x=300:700,y=-400:-100,z=500:1200")


def way(workspace=BOX):
    config = RecordingConfig(n_images=4, translation_mm=10, rotation_deg=4, workspace=workspace)
    at = T_WORLD_REF.copy()
    at[:3, 3] = [0.5, -0.2, 0.9]
    return Way(config.plan(at))


def test_the_way_is_that_of_the_plan_in_the_axes_of_the_reference() -> None:
    shown = way()
    plan, path = shown.plan, shown.path()
    np.testing.assert_allclose(path[0, 0], 0, atol=1e-12)
    np.testing.assert_allclose(path[-1, 1], 0, atol=1e-12)
    np.testing.assert_array_equal(path[1:, 0], path[:-1, 1])
    R, t = plan.T_world_ref[:3, :3], plan.T_world_ref[:3, 3]
    np.testing.assert_allclose(path[:, 1] @ R.T + t, plan.path[:, :3, 3], atol=1e-12)


def test_a_camera_is_drawn_as_far_as_it_sees() -> None:
    shown = way()
    wires = shown.cameras(field_of_view=np.pi / 2, aspect=2.0, size=0.1)
    assert wires.shape == (4, 8, 2, 3)
    apex, corners = wires[:, 0, 0], wires[:, :4, 1]
    np.testing.assert_allclose(apex, shown.camera_at(shown.plan.poses)[:, :3, 3], atol=1e-12)
    length = np.linalg.norm(corners - apex[:, None], axis=2)
    np.testing.assert_allclose(length, 0.1 * np.sqrt(1 + 1 + 4))


def test_taken_and_refused_cameras_have_colours_of_their_own() -> None:
    colours = way().colours((2,), (0,))
    assert [tuple(colours[k, 0, 0]) for k in range(4)] == [
        COLOURS["refused"], COLOURS["planned"], COLOURS["taken"], COLOURS["planned"],
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("workspace", "n_edges"),
    [(BOX, 12), (Workspace.parse("z=500:1200"), 8), (Workspace.parse(""), 0)],
)
def test_the_box_has_edges_where_it_has_limits(workspace, n_edges) -> None:
    shown = way(workspace)
    edges = shown.box()
    assert edges.shape == (n_edges, 2, 3)
    R, t = shown.plan.T_world_ref[:3, :3], shown.plan.T_world_ref[:3, 3]
    corners = (edges @ R.T + t).reshape(-1, 3)
    limits = np.array([workspace.low, workspace.high])
    for k in range(3):
        if n_edges and np.isfinite(limits[0, k]):
            assert np.isclose(corners[:, k, None], limits[:, k]).any(axis=1).all()


OWN = """
import sys
import numpy as np
sys.path.append({tests!r})
from planar_cell import Cell as Planar

class Cell(Planar):
    made = []

    def __init__(self):
        super().__init__(np.zeros(6), noise=1.0)
        self.stops = 0
        self.made.append(self)

    def stop(self):
        self.stops += 1
"""


@pytest.fixture
def command(tmp_path, monkeypatch):
    """The command with a robot of one's own, in a folder of its own."""
    pytest.importorskip("viser")
    tests = str(next(p for p in map(str, sys.path) if p.endswith("tests")))
    (tmp_path / "acquired_cell.py").write_text(OWN.format(tests=tests))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.path", list(sys.path))
    monkeypatch.setattr("servoscope.commands.acquire.wait_for_ctrl_c", lambda: None)
    yield [
        "acquire", "out", "--robot", "acquired_cell:Cell", "--n-images", "3",
        "--translation-mm", "10", "--rotation-deg", "4", "--settle-s", "0.2", "--port", "0",
        "--view",
    ]  # fmt: skip
    sys.modules.pop("acquired_cell", None)


def pressing(monkeypatch, *buttons: str) -> None:
    """Press buttons of the page, one each time that the robot waits."""
    from servoscope.viewer.browser import Browser

    left, say = list(buttons), Browser.say

    def say_and_press(browser, words: str) -> None:
        say(browser, words)
        if "press Step or Run" in words:
            getattr(browser._player, left.pop(0))()

    monkeypatch.setattr(Browser, "say", say_and_press)


def test_the_command_takes_images_as_the_buttons_say(command, monkeypatch, capsys) -> None:
    pressing(monkeypatch, "step", "run")
    assert main([*command, "--json"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["images"] == 3
    assert "Open http://127.0.0.1:" in err
    assert "The page stays until Ctrl-C." in err


def test_stop_ends_the_command_as_ctrl_c_does(command, monkeypatch, capsys) -> None:
    with monkeypatch.context() as patch:
        pressing(patch, "step", "stop")
        assert main(command) == 130
    err = capsys.readouterr().err
    assert "1 of 3 images are on disk; the same command goes on from there." in err
    assert sys.modules["acquired_cell"].Cell.made[0].stops == 1
    pressing(monkeypatch, "run")
    assert main(command) == 0


def test_ctrl_c_while_the_page_waits_ends_the_command(command, monkeypatch, capsys) -> None:
    press = lambda self: signal.raise_signal(signal.SIGINT)  # noqa: E731
    monkeypatch.setattr(LiveAcquisition, "ctrl_c", press, raising=False)
    pressing(monkeypatch, "step", "ctrl_c")
    assert main(command) == 130
    err = capsys.readouterr().err
    assert "1 of 3 images are on disk" in err
    assert "The page stays" not in err
    assert sys.modules["acquired_cell"].Cell.made[0].stops == 1


def test_a_plan_alone_is_shown_and_nothing_moves(command, monkeypatch, capsys) -> None:
    assert main([*command, "--preview"]) == 0
    out, err = capsys.readouterr()
    assert "3 images" in out
    assert "Open http://127.0.0.1:" in err
    assert len(sys.modules["acquired_cell"].Cell.made[0].poses) == 1


def test_images_that_are_rendered_have_no_page(tmp_path, capsys) -> None:
    assert main(["acquire", str(tmp_path / "out"), "--view"]) == 1
    assert "--preview" in capsys.readouterr().err


def test_a_plan_has_no_looks() -> None:
    history = planned(way().plan)
    assert history.looks == []
    assert history.setting.pivot == pytest.approx(0.55)
