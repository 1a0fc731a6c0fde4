"""Bags of a moving camera, written by rosbags."""

from pathlib import Path

import cv2
import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from moving_camera import pose_at

KINDS = [
    *("rosbag 1", "rosbag 1, bz2", "rosbag 1, lz4", "sqlite3", "sqlite3, packed messages"),
    *("sqlite3, packed file", "mcap", "mcap, packed chunks", "mcap, a file alone"),
]


class Recorder:
    """Writes messages of both ROS versions into a bag of some kind."""

    def __init__(self, folder: Path, kind: str) -> None:
        self.is_ros1 = kind.startswith("rosbag 1")
        self.store = get_typestore(Stores.ROS1_NOETIC if self.is_ros1 else Stores.ROS2_HUMBLE)
        if self.is_ros1:
            text = "geometry_msgs/TransformStamped[] transforms"
            self.store.register(get_types_from_msg(text, "tf2_msgs/msg/TFMessage"))
        self.connections = {}
        if self.is_ros1:
            self.path = folder / "recording.bag"
            self.writer = Writer1(self.path)
            if kind.endswith(("bz2", "lz4")):
                self.writer.set_compression(Writer1.CompressionFormat[kind[-3:].upper()])
        else:
            self.path = folder / "recording"
            plugin = StoragePlugin.MCAP if kind.startswith("mcap") else StoragePlugin.SQLITE3
            self.writer = Writer2(self.path, version=9, storage_plugin=plugin)
            mode = {"messages": "MESSAGE", "file": "FILE", "chunks": "STORAGE"}
            if ", packed" in kind:
                mode = CompressionMode[mode[kind.rsplit(" ", 1)[1]]]
                self.writer.set_compression(mode, CompressionFormat.ZSTD)
        self.alone = kind.endswith("alone")

    def __enter__(self):
        self.writer.open()
        return self

    def __exit__(self, *error):
        self.writer.close()
        if self.alone:
            (self.path,) = self.path.glob("*.mcap")

    def write(self, topic, time, message):
        kind = message.__msgtype__
        if topic not in self.connections:
            self.connections[topic] = self.writer.add_connection(topic, kind, typestore=self.store)
        pack = self.store.serialize_ros1 if self.is_ros1 else self.store.serialize_cdr
        self.writer.write(self.connections[topic], round(time * 1e9), pack(message, kind))

    def make(self, kind, *fields):
        return self.store.types[kind](*fields)

    def header(self, time, frame=""):
        stamp = self.make("builtin_interfaces/msg/Time", int(time), round((time - int(time)) * 1e9))
        before = (0,) if self.is_ros1 else ()
        return self.make("std_msgs/msg/Header", *before, stamp, frame)

    def image(self, time, pixels, encoding="mono8", frame="camera", pad=0, big=0):
        rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(len(pixels), -1)
        rows = np.pad(rows, ((0, 0), (0, pad)))
        return self.make(
            "sensor_msgs/msg/Image",
            *(self.header(time, frame), *pixels.shape[:2], encoding, big, rows.shape[1]),
            rows.ravel(),
        )

    def compressed(self, time, pixels, ending, frame="camera"):
        packed = cv2.imencode(f".{ending}", pixels)[1]
        return self.make(
            "sensor_msgs/msg/CompressedImage", self.header(time, frame), ending, packed
        )

    def vector(self, T):
        return self.make("geometry_msgs/msg/Vector3", *map(float, T[:3, 3]))

    def quaternion(self, T):
        q = Rotation.from_matrix(T[:3, :3]).as_quat()
        return self.make("geometry_msgs/msg/Quaternion", *map(float, q))

    def pose(self, time, T):
        place = self.make("geometry_msgs/msg/Point", *map(float, T[:3, 3]))
        pose = self.make("geometry_msgs/msg/Pose", place, self.quaternion(T))
        return self.make("geometry_msgs/msg/PoseStamped", self.header(time), pose)

    def transform(self, time, parent, child, T):
        inside = self.make("geometry_msgs/msg/Transform", self.vector(T), self.quaternion(T))
        return self.make(
            "geometry_msgs/msg/TransformStamped", self.header(time, parent), child, inside
        )

    def frames(self, *transforms):
        return self.make("tf2_msgs/msg/TFMessage", list(transforms))

    def joints(self, time, names, positions):
        empty = np.array([])
        return self.make(
            "sensor_msgs/msg/JointState",
            *(self.header(time), list(names), np.array(positions, dtype=float), empty, empty),
        )


def times_of_images(n=60):
    return 1000.0 + np.arange(n) / 30


def times_of_poses(n=60):
    return 1000.0 + np.arange(-0.5, n / 30 + 0.5, 0.01)


def write_bag(folder, kind, images, *, pose_topic="/pose"):
    """Grey images on ``/image``, and the poses of a moving camera."""
    with Recorder(folder, kind) as recorder:
        events = [(t, "image", i) for i, t in enumerate(times_of_images(len(images)))]
        events += [(t, "pose", None) for t in times_of_poses(len(images))]
        for time, what, i in sorted(events, key=lambda event: event[0]):
            if what == "image":
                recorder.write("/image", time + 0.004, recorder.image(time, images[i]))
            else:
                pose = recorder.pose(time, pose_at([time])[0])
                recorder.write(pose_topic, time + 0.001, pose)
    return recorder.path
