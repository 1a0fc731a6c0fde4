"""The formats that can be imported: one line each, or an entry point ``servoscope.formats``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from servoscope.data.images import PoseImageSet
from servoscope.errors import InvalidInputError
from servoscope.formats.bag import BagOptions, read_bag
from servoscope.formats.bop import BopOptions, read_bop
from servoscope.formats.colmap import ColmapOptions, read_colmap
from servoscope.formats.folder import FolderOptions, read_folder
from servoscope.formats.lerobot import LeRobotOptions, read_lerobot
from servoscope.formats.nerfstudio import NerfstudioOptions, read_nerfstudio
from servoscope.formats.options import ImportOptions
from servoscope.formats.robot_log import LogOptions, read_log
from servoscope.formats.tum import TumOptions, read_tum
from servoscope.plugins import Registry


@dataclass(frozen=True)
class Format:
    """A format: what it is, the class of its options, and ``read(src, options, on_progress)``.

    Options of its examples are shown by ``servoscope import NAME --help``.
    """

    summary: str
    options: type[ImportOptions]
    read: Callable[..., PoseImageSet]
    examples: tuple[str, ...] = ("--max-mm 150 --max-deg 20",)


def _checked(name: str, format_: Any) -> Format:
    if not isinstance(format_, Format):
        raise InvalidInputError(f"the format {name!r} must be a Format, got {repr(format_)[:80]}")
    return format_


FORMATS: Registry[Format] = Registry(
    "servoscope.formats",
    {
        "folder": Format(
            "a folder of images with their poses",
            FolderOptions,
            read_folder,
            (
                "--max-mm 150 --max-deg 20",
                "--poses robot.txt --rotation kuka-abc",
                "--poses '*.pose.txt' --images '*.jpg' --rotation matrix",
                "--session sessions.csv --rotation ur",
            ),
        ),
        "log": Format(
            "images with times, and the log of a robot with times of its own",
            LogOptions,
            read_log,
            (
                "--poses robot.csv --rotation ur --clock-offset estimate",
                "--poses robot.csv --rotation kuka-abc --image-times names --time-unit ms",
            ),
        ),
        "bag": Format(
            "a rosbag 1, a rosbag 2 or MCAP files",
            BagOptions,
            read_bag,
            (
                "--image-topic /camera/image_raw --pose-topic /tcp_pose",
                "--base base_link --camera camera_optical_frame --image-width 320",
                "--urdf arm.urdf --base base_link --camera tool0",
            ),
        ),
        "lerobot": Format(
            "a LeRobotDataset of version 3",
            LeRobotOptions,
            read_lerobot,
            (
                "--columns observation.tcp_pose --rotation ur --episodes 0-3",
                "--columns x,y,z,roll,pitch,yaw --rotation ros-rpy --camera observation.images.top",
            ),
        ),
        "colmap": Format(
            "a reconstruction of COLMAP as text",
            ColmapOptions,
            read_colmap,
            ("--scale 0.21 --max-mm 150 --max-deg 20", "--model sparse/1 --images images_2"),
        ),
        "nerfstudio": Format(
            "a transforms.json of nerfstudio",
            NerfstudioOptions,
            read_nerfstudio,
            ("--scale 0.4 --max-mm 150", "--transforms transforms_train.json --scale 1"),
        ),
        "bop": Format(
            "a scene of the BOP benchmark",
            BopOptions,
            read_bop,
            ("--object 3 --max-mm 150", "--object world --images gray"),
        ),
        "tum": Format("a TUM sequence: rgb.txt and groundtruth.txt", TumOptions, read_tum),
    },
    _checked,
)
"""Formats by the name that the command line knows them by."""
