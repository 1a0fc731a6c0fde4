"""The driver of docs/robots.md, with a controller that is spoken to by lines of text."""

import re
import socketserver
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from servoscope.poses import rigid_transform
from servoscope.robots.devices import CAMERA_KINDS, ROBOT_KINDS, open_robot

PAGE = (Path(__file__).parents[2] / "docs" / "robots.md").read_text(encoding="utf-8")
DRIVER = next(
    code
    for code in re.findall(r"^```python\n(.*?)^```", PAGE, re.M | re.S)
    if "class Robot" in code
)


class Controller(socketserver.StreamRequestHandler):
    """Answers as the page says: mm and rotation vectors."""

    def handle(self):
        for line in self.rfile:
            command, *words = line.decode().split()
            answer = "error joint 3 is hot"
            if command == "pose":
                answer = "ok " + " ".join(map(str, self.server.x))
            elif command == "stop":
                self.server.is_stopped.set()
                answer = "ok"
            elif command == "move" and float(words[2]) < 1000:
                self.server.x = list(map(float, words))
                answer = "ok"
            elif command == "move" and float(words[2]) < 2000:  # until it is stopped
                assert self.server.is_stopped.wait(5)
                answer = "error stopped"
            self.wfile.write(f"{answer}\n".encode())


@pytest.fixture
def controller(tmp_path, monkeypatch):
    server = socketserver.ThreadingTCPServer(("127.0.0.1", 0), Controller)
    server.daemon_threads = True
    server.x, server.is_stopped = [300.0, -200.0, 400.0, 0.1, 2.9, -0.3], threading.Event()
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    code = DRIVER.replace('("192.0.2.7", 5000)', repr(server.server_address))
    (tmp_path / "my_cell.py").write_text(code)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    yield server
    sys.modules.pop("my_cell", None)
    server.shutdown()
    server.server_close()
    thread.join()


def test_the_driver_of_the_page_moves_and_stops(controller):
    robot = open_robot("my_cell:Robot")
    turn = Rotation.from_rotvec([0.1, 2.9, -0.3]).as_matrix()
    np.testing.assert_allclose(robot.pose, rigid_transform(turn, [0.3, -0.2, 0.4]), atol=1e-9)
    goal = rigid_transform(Rotation.from_euler("x", 0.2).as_matrix(), [0.1, 0.2, 0.3])
    robot.move_to(goal)
    np.testing.assert_allclose(robot.pose, goal, atol=1e-6)
    threading.Timer(0.1, robot.stop).start()
    with pytest.raises(RuntimeError, match="answers 'error stopped' to 'move"):
        robot.move_to(rigid_transform(np.eye(3), [0.0, 0.0, 1.5]))
    with pytest.raises(RuntimeError, match="joint 3 is hot"):
        robot.move_to(rigid_transform(np.eye(3), [0.0, 0.0, 2.5]))
    robot.close()


def test_the_page_names_every_kind():
    for kinds in (ROBOT_KINDS, CAMERA_KINDS):
        for name in kinds.built_in:
            assert f"| `{name}:" in PAGE
