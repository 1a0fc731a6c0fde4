"""A bag that is larger than the memory, for docs/importing.md: a camera that moves over a plate.

    .venv/bin/python -m benchmarks.large_bag big 9100

writes 9100 images of 1920 x 1200 pixels and their poses as MCAP into the new folder `big`, 20 GB.
"""

from __future__ import annotations

import sys

import cv2
import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

_HEIGHT, _WIDTH, _PER_SECOND = 1200, 1920, 30


def write_bag(folder: str, n_images: int) -> None:
    """Write the bag, an image and a pose 30 times a second."""
    store = get_typestore(Stores.ROS2_HUMBLE)

    def make(kind: str, *fields: object) -> object:
        return store.types[kind](*fields)

    noise = np.random.default_rng(0).normal(size=(1600, 2400))
    plate = cv2.normalize(
        cv2.GaussianBlur(noise, (0, 0), 12), None, 20, 235, cv2.NORM_MINMAX, cv2.CV_8U
    )
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        kinds = {"/image": "sensor_msgs/msg/Image", "/pose": "geometry_msgs/msg/PoseStamped"}
        topics = {
            topic: bag.add_connection(topic, kind, typestore=store) for topic, kind in kinds.items()
        }
        for i in range(n_images):
            nanoseconds = 10**12 + i * 10**9 // _PER_SECOND
            down = round(150 * np.cos(0.22 * i / _PER_SECOND))
            right = round(200 * np.sin(0.14 * i / _PER_SECOND))
            stamp = make("builtin_interfaces/msg/Time", *divmod(nanoseconds, 10**9))
            header = make("std_msgs/msg/Header", stamp, "base")
            seen = plate[200 + down :, 240 + right :][:_HEIGHT, :_WIDTH].ravel()
            image = make(kinds["/image"], header, _HEIGHT, _WIDTH, "mono8", 0, _WIDTH, seen)
            place = make("geometry_msgs/msg/Point", right / 2000, down / 2000, 0.5)
            turned = make("geometry_msgs/msg/Quaternion", 1.0, 0.0, 0.0, 0.0)
            pose = make(kinds["/pose"], header, make("geometry_msgs/msg/Pose", place, turned))
            for topic, message in (("/pose", pose), ("/image", image)):
                content = store.serialize_cdr(message, kinds[topic])
                bag.write(topics[topic], nanoseconds, content)


if __name__ == "__main__":
    write_bag(sys.argv[1], int(sys.argv[2]))
