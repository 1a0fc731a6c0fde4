"""The formats that can be imported: one line each, or an entry point ``servoscope.formats``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from servoscope.data.images import PoseImageSet
from servoscope.errors import InvalidInputError
from servoscope.formats.bag import BagOptions, read_bag
from servoscope.formats.folder import FolderOptions, read_folder
from servoscope.formats.options import ImportOptions
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
        "tum": Format("a TUM sequence: rgb.txt and groundtruth.txt", TumOptions, read_tum),
    },
    _checked,
)
"""Formats by the name that the command line knows them by."""
