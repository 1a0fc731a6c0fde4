"""Robots and cameras of ROS 2, through a stand-in of rosbridge on a real websocket."""

import base64
import itertools
import sys
import threading
import time

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rosbridge_stand_in import Rosbridge, header, link
from servoscope.errors import (
    CameraFaultError,
    InvalidInputError,
    RobotFaultError,
    RobotStoppedError,
    ServoscopeError,
)
from servoscope.poses import inverse_transform, pose_error, rigid_transform
from servoscope.robots import ros_bridge
from servoscope.robots.devices import open_camera, open_robot

pytest.importorskip("roslibpy")

TOPICS = "?pose=/tcp_pose&goal=/target"


@pytest.fixture
def bridge():
    one = Rosbridge()
    yield one
    one.close()


@pytest.fixture
def opened(bridge):
    """Opens robots and cameras that are closed at the end."""
    devices = []

    def opened(open_one, options):
        devices.append(open_one(f"ros:127.0.0.1:{bridge.port}{options}"))
        return devices[-1]

    yield opened
    for device in devices:
        device.close()


def ahead(robot, metres=0.05, degrees=0.0):
    turn = Rotation.from_euler("z", degrees, degrees=True).as_matrix()
    return robot.pose @ rigid_transform(turn, [0.0, 0.0, metres])


def test_it_goes_where_it_is_sent_and_returns_once_it_stands(bridge, opened):
    robot = opened(open_robot, TOPICS)
    np.testing.assert_allclose(robot.pose, bridge.pose, atol=1e-9)
    goal = ahead(robot, degrees=5.0)
    begin = time.monotonic()
    robot.move_to(goal)
    assert time.monotonic() - begin > 0.05 / bridge.speed
    distance, angle = pose_error(goal, bridge.pose)
    assert distance < 1e-9
    assert angle < 1e-7
    ((frame, _),) = bridge.goals
    assert frame == "base"
    assert bridge.advertised == {"/target": "geometry_msgs/msg/PoseStamped"}
    robot.stop()
    assert len(bridge.goals) == 1  # a robot that stands is sent nothing


def test_the_pose_may_come_from_frames(bridge, opened):
    T = {name: rigid_transform(np.eye(3), [0.0, 0.0, z]) for name, z in (("a", 0.1), ("b", 0.2))}
    T["c"] = rigid_transform(Rotation.from_euler("x", 0.3).as_matrix(), [0.5, 0.0, 0.0])
    bridge.messages["/tf"] = lambda: {
        "transforms": [link("base", "a", T["a"]), link("x", "y", T["c"])]
    }
    bridge.messages["/tf_static"] = lambda: {
        "transforms": [link("/b", "tool", T["c"]), link("a", "b", T["b"])]
    }
    robot = opened(open_robot, "?base=base&tool=tool&goal=/target")
    np.testing.assert_allclose(robot.pose, T["a"] @ T["b"] @ T["c"], atol=1e-12)
    lost = opened(open_robot, "?base=base&tool=hand&goal=/target&read_timeout=0.2")
    with pytest.raises(RobotStoppedError, match="no pose of hand in base within"):
        lost.pose  # noqa: B018


def test_a_robot_that_does_not_get_there_is_stopped_and_says_so(bridge, opened, monkeypatch):
    monkeypatch.setattr(ros_bridge, "_LONGEST_REST", 0.3)
    robot = opened(open_robot, TOPICS)
    bridge.stuck = True
    with pytest.raises(
        RobotStoppedError, match=r"stands 50\.0 mm and 0\.0 deg from where"
    ) as caught:
        robot.move_to(ahead(robot))
    assert len(str(caught.value).splitlines()) == 1
    assert pose_error(bridge.goals[-1][1], bridge.pose)[0] < 1e-9


def test_a_stop_from_another_thread_ends_the_move(bridge, opened):
    robot = opened(open_robot, TOPICS)
    bridge.speed = 0.1
    begin, goal = robot.pose, ahead(robot, 1.0)
    threading.Timer(0.2, robot.stop).start()
    with pytest.raises(RobotStoppedError, match="was stopped during the move"):
        robot.move_to(goal)
    here = robot.pose
    assert 1e-3 < np.linalg.norm((inverse_transform(begin) @ here)[:3, 3]) < 0.1
    time.sleep(0.1)
    assert pose_error(here, robot.pose)[0] < 1e-9


def test_a_service_stops_it(bridge, opened):
    robot = opened(open_robot, f"{TOPICS}&stop=/halt")
    robot.stop()
    assert bridge.calls == ["/halt"]
    bridge.success = False
    with pytest.raises(RobotStoppedError, match=r"could not be stopped \(brake worn"):
        robot.stop()


def test_a_move_that_takes_too_long_is_stopped(bridge, opened):
    robot = opened(open_robot, f"{TOPICS}&timeout=0.2")
    bridge.speed = 0.1
    with pytest.raises(RobotStoppedError, match=r"did not get there in 0\.2 s"):
        robot.move_to(ahead(robot, 1.0))


def test_a_robot_that_falls_silent_says_so(bridge, opened):
    robot = opened(open_robot, f"{TOPICS}&read_timeout=0.2")
    bridge.is_silent = True
    with pytest.raises(RobotStoppedError, match=r"says no pose on /tcp_pose within 0\.2 s"):
        robot.pose  # noqa: B018


def test_a_pose_that_is_none_is_refused(bridge, opened):
    robot = opened(open_robot, TOPICS)
    message = bridge._pose_message()
    message["pose"]["position"]["x"] = None  # what rosbridge makes of NaN
    bridge.messages["/tcp_pose"] = lambda: message
    with pytest.raises(RobotStoppedError, match="that is none"):
        robot.pose  # noqa: B018


def compressed(image):
    data = cv2.imencode(".png", image)[1].tobytes()
    return {"format": "png", "data": base64.b64encode(data).decode(), "header": header("camera")}


def raw(image, encoding):
    height, width = image.shape[:2]
    return {
        "height": height, "width": width, "encoding": encoding, "is_bigendian": 0,
        "step": image.nbytes // height, "data": base64.b64encode(image.tobytes()).decode(),
    }  # fmt: skip


def test_images_compressed_and_raw(bridge, opened, rng):
    grey = rng.integers(0, 256, (6, 8), dtype=np.uint8)
    deep = rng.integers(0, 4096, (6, 8), dtype=np.uint16)
    bridge.messages |= {
        "/cam/compressed": lambda: compressed(grey),
        "/cam": lambda: raw(grey, "mono8"),
    }
    bridge.messages["/deep"] = lambda: raw(deep, "mono16")
    for topic in ("/cam/compressed", "/cam"):
        np.testing.assert_array_equal(opened(open_camera, f"?image={topic}").read(), grey)
    deep_camera = opened(open_camera, "?image=/deep&bit_depth=12")
    np.testing.assert_array_equal(deep_camera.read(), deep >> 4)
    with pytest.raises(CameraFaultError, match="bit_depth=12"):
        opened(open_camera, "?image=/deep").read()


def test_an_image_arrives_after_the_call(bridge, opened):
    count = itertools.count()
    bridge.messages["/cam"] = lambda: raw(np.full((2, 2), next(count), np.uint8), "mono8")
    camera = opened(open_camera, "?image=/cam&skip=2")
    for _ in range(5):
        before = next(count)
        assert camera.read()[0, 0] > before + 1


@pytest.mark.parametrize(
    ("message", "said"),
    [
        ({"data": "AAAA"}, "is no sensor_msgs/msg/Image"),
        ({**raw(np.zeros((4, 4), np.uint8), "mono8"), "data": "?"}, "no base64"),
        (raw(np.zeros((4, 4), np.uint8), "nv12"), "encoding 'nv12'"),
        ({**raw(np.zeros((4, 4), np.uint8), "mono8"), "height": 9}, "holds 16 bytes"),
    ],
)
def test_messages_that_are_no_images_are_refused_in_a_line(bridge, opened, message, said):
    bridge.messages["/cam"] = lambda: message
    with pytest.raises(CameraFaultError, match=said) as caught:
        opened(open_camera, "?image=/cam").read()
    assert len(str(caught.value).splitlines()) == 1


def test_a_topic_without_images_says_so(opened):
    with pytest.raises(CameraFaultError, match=r"No image came on /none within 0\.2 s"):
        opened(open_camera, "?image=/none&timeout=0.2").read()


@pytest.mark.parametrize(
    "text",
    ["h:9090", "h?pose=/p", "h?goal=/g", "h?goal=/g&base=a", "h:x?pose=/p&goal=/g", "h?x=1"],
)
def test_what_is_missing_is_said(text):
    with pytest.raises(InvalidInputError):
        open_robot(f"ros:{text}")


def test_a_bridge_that_is_not_there_says_so(bridge):
    bridge.close()
    with pytest.raises(RobotFaultError, match="cannot be reached"):
        open_robot(f"ros:127.0.0.1:{bridge.port}{TOPICS}")
    with pytest.raises(CameraFaultError, match="cannot be reached"):
        open_camera(f"ros:127.0.0.1:{bridge.port}?image=/cam")


def test_without_the_library_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "roslibpy", None)
    with pytest.raises(ServoscopeError, match=r"pip install \"servoscope\[ros\]\""):
        open_camera("ros:127.0.0.1?image=/cam")
