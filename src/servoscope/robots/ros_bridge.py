"""Robots and cameras of ROS 2, through rosbridge: no ROS is needed on this machine."""

from __future__ import annotations

import base64
import binascii
import socket
import time
from collections.abc import Callable
from threading import Event
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.errors import (
    CameraFaultError,
    DataSetError,
    InvalidInputError,
    RobotFaultError,
    RobotStoppedError,
    ServoscopeError,
)
from servoscope.formats.ros_images import COMPRESSED, RAW, grey_of_message
from servoscope.poses import as_rigid, pose_error, poses_from_quaternions, quaternions_xyzw
from servoscope.robots.arrivals import Arrivals
from servoscope.robots.camera_image import camera_image
from servoscope.robots.options import check_range, split_options
from servoscope.storage.reading import without_advice
from servoscope.wording import one_line

Array = NDArray[np.float64]

ROBOT_OPTIONS: dict[str, Callable[[str], Any]] = {
    "pose": str,
    "base": str,
    "tool": str,
    "goal": str,
    "stop": str,
    "timeout": float,
    "read_timeout": float,
}
"""Of ``--robot ros:HOST:PORT?name=value``."""

CAMERA_OPTIONS: dict[str, Callable[[str], Any]] = {
    "image": str,
    "image_width": int,
    "bit_depth": int,
    "delay": float,
    "skip": int,
    "timeout": float,
}
"""Of ``--camera ros:HOST:PORT?name=value``."""

PORT = 9090
"""Where rosbridge listens, if nothing else is said."""

ARRIVED = 5e-4, float(np.radians(0.1))
"""Farther from where it was sent than this a robot has not arrived, [m] and [rad]."""

STANDING = 1e-4, float(np.radians(0.02))
"""A robot whose pose changes by no more than this stands, [m] and [rad]."""

_CONNECTION_TIMEOUT = 5.0
_SETTLED = 0.3
_LONGEST_REST = 5.0
_STOP_TIME = 3.0
_POSE, _FRAMES = "geometry_msgs/msg/PoseStamped", "tf2_msgs/msg/TFMessage"
_TRIGGER = "std_srvs/srv/Trigger"


def ros_robot(text: str) -> RosRobot:
    """The robot that is written ``ros:HOST:PORT?name=value``, without the kind."""
    address, options = split_options(text, ROBOT_OPTIONS)
    return RosRobot(*_host_and_port(address), **options)


def ros_camera(text: str) -> RosCamera:
    """The camera that is written ``ros:HOST:PORT?name=value``, without the kind."""
    address, options = split_options(text, CAMERA_OPTIONS)
    return RosCamera(*_host_and_port(address), **options)


class RosRobot:
    """A robot whose controller follows a topic of goals.

    Parameters
    ----------
    host : str
    port : int
        Where rosbridge listens.
    pose : str, optional
        Topic of ``PoseStamped`` that says where the robot is.
    base, tool : str, optional
        Instead of a topic: frames of tf, whose chain gives the pose.
    goal : str
        Topic of ``PoseStamped`` that the controller follows. A goal is in the frame that the poses
        name, or in `base`.
    stop : str, optional
        Service of ``std_srvs/Trigger`` that stops the robot. Without it a robot that moves is
        stopped by a goal where it is.
    timeout : float
        How long a move may take, [s].
    read_timeout : float
        How long a pose may take, [s].

    Raises
    ------
    ServoscopeError
        If ``roslibpy`` is not installed.
    InvalidInputError
        If a topic is missing.
    RobotFaultError
        If rosbridge cannot be reached.
    """

    def __init__(
        self,
        host: str,
        port: int = PORT,
        *,
        pose: str | None = None,
        base: str | None = None,
        tool: str | None = None,
        goal: str | None = None,
        stop: str | None = None,
        timeout: float = 60.0,
        read_timeout: float = 5.0,
    ) -> None:
        has_frames = base is not None and tool is not None
        if (pose is None) != has_frames or not goal:
            raise InvalidInputError(
                "A robot of ROS must have a topic of goals, and a topic of poses or two frames, "
                "such as ros:HOST:9090?pose=/tcp_pose&goal=/target or "
                "ros:HOST:9090?base=base_link&tool=tool0&goal=/target."
            )
        check_range("timeout", timeout, 0.1, 600, "s")
        check_range("read_timeout", read_timeout, 0.1, 60, "s")
        self._where = f"at {host}:{port}"
        self._source = f"on {pose}" if pose is not None else f"of {tool} in {base}"
        self._timeout, self._read_timeout = timeout, read_timeout
        self._is_stopped, self._is_under_way = Event(), False
        self._poses, self._links = Arrivals(), {}  # type: tuple[Arrivals, dict[str, Any]]
        self._base, self._tool = base or "", tool or ""
        self._roslibpy, self._ros = _connected(host, port, RobotFaultError)
        self._goals = self._roslibpy.Topic(self._ros, goal, _POSE, queue_size=1)
        self._goals.advertise()
        self._stop_service = (
            None if stop is None else self._roslibpy.Service(self._ros, stop, _TRIGGER)
        )
        if pose is not None:
            self._subscribe(pose, _POSE, self._note_pose)
        else:
            for topic in ("/tf", "/tf_static"):
                self._subscribe(topic, _FRAMES, self._note_links)

    @property
    def pose(self) -> Array:
        """The pose of a message that arrives after the call, (4, 4), [m].

        Raises
        ------
        RobotStoppedError
            If none comes in time, or it is none.
        """
        return self._arrived()[0]

    def move_to(self, pose: ArrayLike) -> None:
        """Move to a pose (4, 4), [m]; returns once the robot stands there.

        Raises
        ------
        InvalidInputError
            If it is no rigid transform; nothing was sent.
        RobotStoppedError
            If the robot does not get there; it is stopped then.
        """
        target = as_rigid(pose, "pose")
        start, frame = self._arrived()
        self._is_stopped.clear()
        self._is_under_way = True
        try:
            self._send(target, frame)
            self._follow(target, start)
        except BaseException:
            self.stop()
            raise
        self._is_under_way = False

    def stop(self) -> None:
        """Bring the robot to a standstill.

        Raises
        ------
        RobotStoppedError
            If it still moves after 3 s, or its service fails.
        """
        self._is_stopped.set()
        if self._stop_service is not None:
            self._call_stop(self._stop_service)
        elif self._is_under_way:
            self._send(*self._arrived())
        end, before = time.monotonic() + _STOP_TIME, self.pose
        while True:
            time.sleep(_SETTLED)
            here = self.pose
            if not _is_apart(before, here, STANDING):
                break
            if time.monotonic() > end:
                raise self._fault("still moves though it was stopped; press its emergency stop")
            before = here
        self._is_under_way = False

    def close(self) -> None:
        """End the connection."""
        self._poses.end()
        self._ros.close()

    def _subscribe(self, topic: str, kind: str, note: Callable[[Any], None]) -> None:
        self._roslibpy.Topic(
            self._ros, topic, kind, queue_length=1 if kind == _POSE else 0
        ).subscribe(note)

    def _note_pose(self, message: Any) -> None:
        self._poses.put(lambda: message)

    def _note_links(self, message: Any) -> None:
        """Note where frames are in their parents."""
        is_new = False
        for transform in message["transforms"]:
            child = str(transform["child_frame_id"]).lstrip("/")
            parent = str(transform["header"]["frame_id"]).lstrip("/")
            self._links[child] = parent, transform["transform"]
            is_new = True
        if is_new:
            self._poses.put(self._chain)

    def _chain(self) -> Any:
        """The transforms from the base to the tool, if all are known."""
        chain: list[Any] = []
        frame = self._tool
        while frame != self._base:
            if frame not in self._links or len(chain) > len(self._links):
                return None
            frame, transform = self._links[frame]
            chain.insert(0, transform)
        return {"header": {"frame_id": self._base}, "pose": chain}

    def _arrived(self) -> tuple[Array, str]:
        """A new pose and the frame that it is in."""
        item = self._poses.after(time.monotonic(), 0, self._read_timeout)
        if item is None:
            raise self._fault(
                f"says no pose {self._source} within {self._read_timeout:g} s; see that it is "
                "published and that rosbridge runs"
            )
        T = np.eye(4)
        try:
            frame, poses = str(item["header"]["frame_id"]), item["pose"]
            for fields in poses if isinstance(poses, list) else [poses]:
                T = T @ _transform(fields)
        except (InvalidInputError, KeyError, TypeError, ValueError) as error:
            raise self._fault(
                f"says a pose {self._source} that is none ({one_line(error)})"
            ) from error
        return T, frame

    def _send(self, pose: Array, frame: str) -> None:
        x, y, z = (float(value) for value in pose[:3, 3])
        qx, qy, qz, qw = (float(value) for value in quaternions_xyzw(pose))
        fields = {
            "position": {"x": x, "y": y, "z": z},
            "orientation": {"x": qx, "y": qy, "z": qz, "w": qw},
        }
        message = {"header": {"frame_id": frame}, "pose": fields}
        if not self._ros.is_connected:
            raise self._fault("has lost its connection; see that rosbridge runs")
        self._goals.publish(self._roslibpy.Message(message))

    def _follow(self, target: Array, start: Array) -> None:
        """Wait until the robot stands at the target; raise what keeps it from getting there."""
        end = time.monotonic() + self._timeout
        before, since = start, time.monotonic()
        while True:
            if self._is_stopped.is_set():
                raise self._fault("was stopped during the move")
            here, now = self.pose, time.monotonic()
            if _is_apart(before, here, STANDING):
                before, since = here, now
            is_there = not _is_apart(target, here, ARRIVED)
            if is_there and now - since >= _SETTLED:
                return
            if not is_there and now - since > _LONGEST_REST:
                distance, angle = pose_error(target, here)
                raise self._fault(
                    f"stands {1e3 * distance:.1f} mm and {np.degrees(angle):.1f} deg from where it "
                    "was sent; see that its controller is active and can reach the pose"
                )
            if now > end:
                raise self._fault(f"did not get there in {self._timeout:g} s")

    def _call_stop(self, service: Any) -> None:
        request = self._roslibpy.ServiceRequest()
        try:
            answer = service.call(request, timeout=_STOP_TIME)
        except Exception as error:
            raise self._fault(f"could not be stopped ({one_line(error)})") from error
        if not answer.get("success"):
            raise self._fault(f"could not be stopped ({one_line(answer.get('message', ''))})")

    def _fault(self, reason: str) -> RobotStoppedError:
        return RobotStoppedError(f"The robot of ROS {self._where} {reason}.")


class RosCamera:
    """A camera whose images are on a topic.

    Parameters
    ----------
    host : str
    port : int
        Where rosbridge listens.
    image : str
        Topic of ``sensor_msgs/CompressedImage`` if its last name is ``compressed``, else of
        ``sensor_msgs/Image``.
    image_width : int, optional
        Width that images are resized to, as `servoscope import` does, [px].
    bit_depth : int, optional
        Bits that the values of 16-bit images fill; they are not read without it.
    delay : float
        How much later than it was taken an image arrives, beyond those that are skipped, [s].
    skip : int
        Images that are skipped after the call.
    timeout : float
        How long an image may take, [s].

    Raises
    ------
    ServoscopeError
        If ``roslibpy`` is not installed.
    InvalidInputError
        If no topic is named, or a number is not of its range.
    CameraFaultError
        If rosbridge cannot be reached.
    """

    def __init__(
        self,
        host: str,
        port: int = PORT,
        *,
        image: str | None = None,
        image_width: int | None = None,
        bit_depth: int | None = None,
        delay: float = 0.0,
        skip: int = 2,
        timeout: float = 5.0,
    ) -> None:
        if not image:
            raise InvalidInputError(
                "A camera of ROS must have a topic, such as "
                "ros:HOST:9090?image=/camera/image_raw/compressed."
            )
        check_range("image_width", image_width, 1, 1 << 16, "px")
        check_range("bit_depth", bit_depth, 8, 16)
        check_range("delay", delay, 0, 60, "s")
        check_range("skip", skip, 0, 1000)
        check_range("timeout", timeout, 0.1, 600, "s")
        self.topic, self.image_width, self.bit_depth = image, image_width, bit_depth
        self.delay, self.skip, self.timeout = delay, skip, timeout
        self._kind = COMPRESSED if image.split("/")[-1] == "compressed" else RAW
        self._images = Arrivals()
        roslibpy, self._ros = _connected(host, port, CameraFaultError)
        topic = roslibpy.Topic(self._ros, image, self._kind, queue_length=1)
        topic.subscribe(lambda message: self._images.put(lambda: message))

    def read(self) -> NDArray[np.uint8]:
        """A grey image that arrives after the call, (height, width).

        Raises
        ------
        CameraFaultError
            If none comes in time, or it is none.
        """
        message = self._images.after(time.monotonic() + self.delay, self.skip, self.timeout)
        if message is None:
            raise CameraFaultError(
                f"No image came on {self.topic} within {self.timeout:g} s; see that it is "
                "published and that rosbridge runs."
            )
        try:
            fields = SimpleNamespace(**{**message, "data": _bytes(message["data"])})
            levels = grey_of_message(fields, self._kind, self.topic)
        except DataSetError as error:
            raise CameraFaultError(f"{without_advice(error)}.") from error
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise CameraFaultError(
                f"The message on {self.topic} is no {self._kind} ({one_line(error)}); name a topic "
                "of images."
            ) from error
        return camera_image(levels, self.image_width, self.bit_depth, self.topic)

    def close(self) -> None:
        """End the connection."""
        self._images.end()
        self._ros.close()


def _host_and_port(address: str) -> tuple[str, int]:
    host, colon, port = address.rpartition(":")
    if not colon:
        return address, PORT
    if not (host and port.isascii() and port.isdigit() and 0 < int(port) < 1 << 16):
        raise InvalidInputError(f"rosbridge must be at HOST:PORT, got {address!r}.")
    return host, int(port)


def _connected(host: str, port: int, fault: type[ServoscopeError]) -> tuple[Any, Any]:
    """The library, and a connection to rosbridge."""
    try:
        import roslibpy
    except ImportError as error:
        raise ServoscopeError(
            'ROS needs roslibpy; install it with: pip install "servoscope[ros]".'
        ) from error
    advice = "see that rosbridge_server runs there, and that the address is right"
    try:
        socket.create_connection((host, port), timeout=_CONNECTION_TIMEOUT).close()
        ros = roslibpy.Ros(host, port, transport="asyncio")
        ros.run(_CONNECTION_TIMEOUT)
    except Exception as error:
        raise fault(
            f"rosbridge at {host}:{port} cannot be reached ({one_line(error)}); {advice}."
        ) from error
    return roslibpy, ros


def _transform(fields: Any) -> Array:
    """The matrix of a ``Pose`` or a ``Transform``."""
    t = fields["position"] if "position" in fields else fields["translation"]
    q = fields["orientation"] if "orientation" in fields else fields["rotation"]
    return poses_from_quaternions(
        [[float(t[name]) for name in "xyz"]], [[float(q[name]) for name in "xyzw"]]
    )[0]


def _is_apart(T_a: Array, T_b: Array, limits: tuple[float, float]) -> bool:
    distance, angle = pose_error(T_a, T_b)
    return bool(distance > limits[0] or angle > limits[1])


def _bytes(data: Any) -> NDArray[np.uint8]:
    """The bytes of a field, which rosbridge sends as base64 or as a list of numbers."""
    if isinstance(data, str):
        try:
            return np.frombuffer(base64.b64decode(data, validate=True), np.uint8)
        except binascii.Error as error:
            raise ValueError(f"its data is no base64: {error}") from error
    return np.array(data, dtype=np.uint8)
