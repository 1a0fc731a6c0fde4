"""A stand-in of rosbridge: its protocol over a real websocket, and a robot behind it.

Protocol: github.com/RobotWebTools/rosbridge_suite, ROSBRIDGE_PROTOCOL.md.
"""

import json
import threading
import time

import numpy as np
from scipy.spatial.transform import Rotation
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import serve

from servoscope.poses import quaternions_xyzw, rigid_transform

INTERVAL = 0.01


class Rosbridge:
    """Publishes where a robot is and what a camera sees; the robot follows goals."""

    def __init__(self):
        self.pose = rigid_transform(
            Rotation.from_euler("xyz", [3.0, 0.1, 0.2]).as_matrix(), [0.4, 0.1, 0.3]
        )
        self.goal, self.speed, self.stuck = self.pose.copy(), 0.5, False
        self.goals, self.calls, self.advertised = [], [], {}
        self.success, self.is_silent = True, False
        self.messages = {"/tcp_pose": self._pose_message}  # by topic, what makes one
        self._server = serve(self._serve, "127.0.0.1", 0)
        self.port = self._server.socket.getsockname()[1]
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()
        self._is_closed = threading.Event()
        self._mover = threading.Thread(target=self._move, daemon=True)
        self._mover.start()

    def close(self):
        self._is_closed.set()
        self._mover.join()
        self._server.shutdown()
        self._thread.join()

    def _move(self):
        while not self._is_closed.wait(INTERVAL):
            way = self.goal[:3, 3] - self.pose[:3, 3]
            step, length = self.speed * INTERVAL, np.linalg.norm(way)
            if self.stuck or (length == 0 and np.array_equal(self.pose, self.goal)):
                continue
            pose = self.goal.copy()
            if length > step:
                pose = self.pose.copy()
                pose[:3, 3] += step * way / length
            self.pose = pose

    def _serve(self, connection):
        subscribed = {}
        publisher = threading.Thread(
            target=self._publish, args=(connection, subscribed), daemon=True
        )
        publisher.start()
        try:
            for text in connection:
                self._hear(connection, json.loads(text), subscribed)
        except ConnectionClosed:
            pass

    def _hear(self, connection, message, subscribed):
        match message["op"]:
            case "subscribe":
                subscribed[message["topic"]] = message["type"]
            case "advertise":
                self.advertised[message["topic"]] = message["type"]
            case "publish":
                assert message["topic"] in self.advertised
                self._follow(message["msg"])
            case "call_service":
                self.calls.append(message["service"])
                self.goal = self.pose.copy()
                answer = {"op": "service_response", "id": message["id"], "result": True}
                answer |= {"service": message["service"]}
                answer |= {"values": {"success": self.success, "message": "brake worn"}}
                connection.send(json.dumps(answer))

    def _follow(self, message):
        p, q = message["pose"]["position"], message["pose"]["orientation"]
        turn = Rotation.from_quat([q[name] for name in "xyzw"]).as_matrix()
        self.goal = rigid_transform(turn, [p[name] for name in "xyz"])
        self.goals.append((message["header"]["frame_id"], self.goal))

    def _publish(self, connection, subscribed):
        try:
            while not self._is_closed.wait(INTERVAL):
                for topic, kind in list(subscribed.items()):
                    make = self.messages.get(topic)
                    assert topic != "/tcp_pose" or kind == "geometry_msgs/msg/PoseStamped"
                    if make is None or self.is_silent:
                        continue
                    connection.send(json.dumps({"op": "publish", "topic": topic, "msg": make()}))
        except ConnectionClosed:
            pass

    def _pose_message(self):
        return {"header": header("base"), "pose": fields(self.pose, "position", "orientation")}


def header(frame):
    return {"stamp": {"sec": int(time.time()), "nanosec": 0}, "frame_id": frame}


def fields(pose, position, orientation):
    t, q = pose[:3, 3], quaternions_xyzw(pose)
    return {
        position: {name: float(t[i]) for i, name in enumerate("xyz")},
        orientation: {name: float(q[i]) for i, name in enumerate("xyzw")},
    }


def link(parent, child, pose):
    transform = fields(pose, "translation", "rotation")
    return {"header": header(parent), "child_frame_id": child, "transform": transform}
