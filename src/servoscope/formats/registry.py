"""The formats that can be imported: one line each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from servoscope.data.images import PoseImageSet
from servoscope.formats.folder import read_folder
from servoscope.formats.options import ImportOptions
from servoscope.formats.tum import TumOptions, read_tum


@dataclass(frozen=True)
class Format:
    """A format: what it is, the class of its options, and ``read(src, options, on_progress)``."""

    summary: str
    options: type[ImportOptions]
    read: Callable[..., PoseImageSet]


FORMATS = {
    "folder": Format("a folder of images with poses.csv", ImportOptions, read_folder),
    "tum": Format("a TUM sequence: rgb.txt and groundtruth.txt", TumOptions, read_tum),
}
"""Formats by the name that the command line knows them by."""
