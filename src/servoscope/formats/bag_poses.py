"""Poses in the messages of a bag: stamped ones, chains of frames, joints of an arm."""

from __future__ import annotations

from array import array
from collections import defaultdict, deque
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from servoscope.data.trajectory import Trajectory, pair_in_time
from servoscope.errors import DataSetError
from servoscope.formats.bag_files import FRAMES, Bag, Message
from servoscope.formats.frames import BAD_POSE, Drops
from servoscope.formats.kinematic_chain import KinematicChain
from servoscope.poses import inverse_transform, pose_error, poses_from_quaternions

Array = NDArray[np.float64]

POSES = {
    "geometry_msgs/msg/PoseStamped": "pose",
    "geometry_msgs/msg/PoseWithCovarianceStamped": "pose.pose",
    "nav_msgs/msg/Odometry": "pose.pose",
    "geometry_msgs/msg/TransformStamped": "transform",
}
"""Types of messages that hold one pose, and where."""

JOINTS = "sensor_msgs/msg/JointState"

_MOST_LOOKED_AT = 20_000  # messages of frames, for the tree that they form
_SAME_M, _SAME_RAD = 1e-4, 1e-4


class PoseSource(Protocol):
    """What collects the poses of a bag."""

    topics: list[str]

    def add(self, message: Message, stamp: float) -> None:
        """Note a message of one of the topics; `stamp` [s] is that of the message."""

    def trajectory(self, skip_bad: bool, drops: Drops) -> Trajectory:
        """The poses that were noted, in any order."""


class StampedPoses:
    """Poses of one topic whose messages hold one each."""

    def __init__(self, bag: Bag, topic: str) -> None:
        self.topics = [topic]
        self._place = POSES[bag.types[topic]].split(".")
        self._numbers = array("d")

    def add(self, message: Message, stamp: float) -> None:
        """Note the pose of a message."""
        fields = message.fields
        for name in self._place:
            fields = getattr(fields, name)
        self._numbers.extend((stamp, *_seven(fields)))

    def trajectory(self, skip_bad: bool, drops: Drops) -> Trajectory:
        """The poses that were noted."""
        return _trajectory(self._numbers, self.topics[0], skip_bad, drops)


class FrameChain:
    """The pose of one frame in another, along the tree that messages of frames form.

    Parameters
    ----------
    bag : Bag
    base, camera : str, optional
        Frames; by default the root of the tree, and that of the images.
    camera_of_images : str
        Frame that the images name.
    most_gap : float
        How far in time the transforms of one pose may be apart, [s].
    """

    def __init__(
        self,
        bag: Bag,
        base: str | None,
        camera: str | None,
        camera_of_images: str,
        most_gap: float,
    ) -> None:
        self.topics = bag.of_types(FRAMES)
        self._most_gap = most_gap
        self._edges = self._find(bag, _bare(base), _bare(camera) or _bare(camera_of_images))
        self._numbers: dict[tuple[str, str], array[float]] = defaultdict(lambda: array("d"))
        self._fixed: set[tuple[str, str]] = set()
        self._wanted = {edge for edge, _ in self._edges}

    def add(self, message: Message, stamp: float) -> None:
        """Note the transforms of a message that lie on the chain."""
        for transform in message.fields.transforms:
            edge = _edge(transform)
            if edge not in self._wanted:
                continue
            if message.topic.endswith("tf_static"):
                self._fixed.add(edge)
            self._numbers[edge].extend((_seconds(transform.header), *_seven(transform.transform)))

    def trajectory(self, skip_bad: bool, drops: Drops) -> Trajectory:
        """The chain at the times of the transform that comes most often."""
        parts = {}
        for edge in self._wanted:
            numbers = self._numbers[edge]
            parts[edge] = _trajectory(numbers, f"{edge[0]} -> {edge[1]}", skip_bad, drops)
            if edge in self._fixed or len(parts[edge].times) == 1:
                parts[edge] = _at_rest(parts[edge], edge)
        moving = [part for part in parts.values() if len(part.times) > 1]
        if not moving:
            raise DataSetError(
                f"The frames {self._names()} never move against each other in the bag; name others "
                "with --base and --camera."
            )
        times = max(moving, key=lambda part: len(part.times)).times
        T, near = np.tile(np.eye(4), (len(times), 1, 1)), np.ones(len(times), dtype=bool)
        for edge, is_forward in self._edges:
            part, gaps = pair_in_time(parts[edge], times)
            if len(parts[edge].times) > 1:
                near &= gaps <= self._most_gap
            T = T @ (part if is_forward else inverse_transform(part))
        return Trajectory(times[near], T[near])

    def _names(self) -> str:
        return ", ".join(f"{parent} -> {child}" for (parent, child), _ in self._edges)

    def _find(
        self, bag: Bag, base: str | None, camera: str | None
    ) -> list[tuple[tuple[str, str], bool]]:
        """Edges from base to camera, each with whether it is taken from parent to child."""
        edges: dict[tuple[str, str], None] = {}
        for n, message in enumerate(bag.messages(self.topics)):
            n_edges = len(edges)
            edges.update(dict.fromkeys(_edge(t) for t in message.fields.transforms))
            if base and camera and len(edges) > n_edges and _between(base, camera, edges):
                break
            if n >= _MOST_LOOKED_AT:
                break
        frames = sorted({frame for edge in edges for frame in edge})
        there = f"its frames are {', '.join(frames) or 'none'}"
        if camera is None:
            raise DataSetError(f"{bag.path}: the images name no frame; say --camera, {there}.")
        for frame, how in ((base, "--base names"), (camera, "--camera or the images name")):
            if frame is not None and frame not in frames:
                raise DataSetError(f"{bag.path} has no frame {frame!r}, which {how}; {there}.")
        path = _path_up(camera, edges)
        if base is None:
            return path
        between = _between(base, camera, edges)
        if not between:
            raise DataSetError(f"{bag.path} does not join {base} and {camera}; {there}.")
        return between


class Joints:
    """The pose of a link of an arm from the positions of its joints.

    Parameters
    ----------
    topic : str
    chain : KinematicChain
    urdf : Path
        For errors.
    """

    def __init__(self, topic: str, chain: KinematicChain, urdf: Path) -> None:
        self.topics = [topic]
        self._chain, self._urdf = chain, urdf
        self._names = chain.joint_names
        self._seen: set[str] = set()
        self._numbers = array("d")

    def add(self, message: Message, stamp: float) -> None:
        """Note the positions of the joints, if all are in the message."""
        positions = dict(zip(message.fields.name, message.fields.position, strict=False))
        if len(self._seen) < 1000:
            self._seen.update(positions)
        if all(name in positions for name in self._names):
            self._numbers.extend((stamp, *(positions[name] for name in self._names)))

    def trajectory(self, skip_bad: bool, drops: Drops) -> Trajectory:
        """The poses at the positions that were noted."""
        table = np.frombuffer(self._numbers).reshape(-1, 1 + len(self._names))
        if not len(table):
            raise DataSetError(
                f"No message of {self.topics[0]} holds all of {', '.join(self._names)}, as "
                f"{self._urdf} calls them; there are {', '.join(sorted(self._seen)) or 'none'}."
            )
        finite = np.asarray(np.isfinite(table).all(axis=1))
        _check_usable(finite, table[:, 0], self.topics[0], "finite positions", skip_bad, drops)
        return Trajectory(table[finite, 0], self._chain.poses(table[finite, 1:]))


def stamp_of(message: Message, stamps: str) -> float:
    """When a message was taken, [s]: by its header, or when it was logged.

    Raises
    ------
    DataSetError
        If its header has no stamp.
    """
    header = getattr(message.fields, "header", None)
    if stamps == "log" or (header is None and hasattr(message.fields, "transforms")):
        return message.logged * 1e-9
    if header is None or not (header.stamp.sec or header.stamp.nanosec):
        raise DataSetError(
            f"Messages of {message.topic} are not stamped; take the times when they were logged, "
            "with --stamps log."
        )
    return _seconds(header)


def _seconds(header: Any) -> float:
    return float(header.stamp.sec) + 1e-9 * float(header.stamp.nanosec)


def _seven(pose: Any) -> tuple[float, ...]:
    """Translation and quaternion xyzw of a Pose or a Transform."""
    t = pose.position if hasattr(pose, "position") else pose.translation
    q = pose.orientation if hasattr(pose, "orientation") else pose.rotation
    return t.x, t.y, t.z, q.x, q.y, q.z, q.w


def _bare(frame: str | None) -> str | None:
    """The name of a frame without the slash that ROS 1 may put before it."""
    return frame.lstrip("/") if frame else None


def _edge(transform: Any) -> tuple[str, str]:
    return transform.header.frame_id.lstrip("/"), transform.child_frame_id.lstrip("/")


def _path_up(frame: str, edges: dict[tuple[str, str], None]) -> list[tuple[tuple[str, str], bool]]:
    """The edges from the root of the tree to a frame."""
    parents = {child: parent for parent, child in edges}
    path: list[tuple[tuple[str, str], bool]] = []
    while frame in parents and len(path) <= len(edges):
        path.append(((parents[frame], frame), True))
        frame = parents[frame]
    return path[::-1]


def _between(
    base: str, camera: str, edges: dict[tuple[str, str], None]
) -> list[tuple[tuple[str, str], bool]]:
    """The shortest way from one frame to another."""
    ways: dict[str, list[tuple[tuple[str, str], bool]]] = {base: []}
    queue = deque([base])
    while queue and camera not in ways:
        frame = queue.popleft()
        for parent, child in edges:
            for here, there, is_forward in ((parent, child, True), (child, parent, False)):
                if here == frame and there not in ways:
                    ways[there] = [*ways[frame], ((parent, child), is_forward)]
                    queue.append(there)
    return ways.get(camera, [])


def _trajectory(numbers: array[float], what: str, skip_bad: bool, drops: Drops) -> Trajectory:
    table = np.frombuffer(numbers).reshape(-1, 8)
    if not len(table):
        raise DataSetError(f"The bag holds no pose of {what}.")
    lengths = np.abs(table[:, 4:]).max(axis=1)
    usable = np.isfinite(table).all(axis=1) & (lengths > 1e-6) & (lengths < 1e6)
    _check_usable(usable, table[:, 0], what, "a finite pose with a quaternion", skip_bad, drops)
    table = table[usable]
    return Trajectory(table[:, 0], poses_from_quaternions(table[:, 1:4], table[:, 4:]))


def _check_usable(
    usable: NDArray[np.bool_],
    times: Array,
    what: str,
    wanted: str,
    skip_bad: bool,
    drops: Drops,
) -> None:
    bad = times[~usable]
    if len(bad) and not skip_bad:
        raise DataSetError(
            f"{what}, at {bad[0]:.6f} s: must hold {wanted}, but does not ({len(bad)} such "
            "messages); leave them out with --skip-bad."
        )
    if not usable.any():
        raise DataSetError(f"{what}: none of {len(usable)} messages holds {wanted}.")
    drops.add(BAD_POSE, [f"{what} at {time:.6f}" for time in bad])


def _at_rest(part: Trajectory, edge: tuple[str, str]) -> Trajectory:
    """The one pose of a transform that is said not to move."""
    metres, radians = pose_error(part.T_world_cam[0], part.T_world_cam)
    if metres.max() > _SAME_M or radians.max() > _SAME_RAD:
        raise DataSetError(
            f"The static transform {edge[0]} -> {edge[1]} changes by {1e3 * metres.max():.3g} mm "
            f"and {np.degrees(radians.max()):.3g} deg; divide the bag where it does."
        )
    return Trajectory(part.times[:1], part.T_world_cam[:1])
