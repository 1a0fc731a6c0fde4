"""Images with times, and the log of a robot with times of its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from servoscope.data.images import PoseImageSet
from servoscope.data.trajectory import Trajectory
from servoscope.errors import DataSetError
from servoscope.formats.conventions import poses_from_numbers
from servoscope.formats.folder import images_by_key
from servoscope.formats.frames import BAD_POSE, EQUAL_STAMPS, Drops, Frames, check_names_differ
from servoscope.formats.pose_table import TableOptions, read_pose_table, read_times
from servoscope.formats.pose_text import (
    as_T_world_cam,
    check_folder,
    check_unit_length,
    parse_numbers,
    relative_name,
)
from servoscope.formats.recordings import RecordingOptions, assemble_recording
from servoscope.formats.stamps import check_seconds, resolution, without_equal_stamps

TimeUnit = Literal["s", "ms", "us", "ns"]

SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
"""Seconds of each unit."""

NAMES = "names"
"""The `image_times` of images whose names are their times."""


@dataclass(frozen=True, kw_only=True)
class LogOptions(TableOptions, RecordingOptions):
    """Options of images with the log of a robot, besides those of tables and of recordings.

    Parameters
    ----------
    poses : str
        Name of the log: a table with a time and a pose in each row.
    image_times : str
        Name of a table with the name and the time of each image; or names, where the names of the
        images are their times.
    images : str
        Which images, with a ``*`` for the time, where the names are the times.
    time_unit : {"s", "ms", "us", "ns"}
        Of the times of the log.
    image_time_unit : {"s", "ms", "us", "ns"}, optional
        Of the times of the images, if it is another.
    max_gap_s : float
        Largest gap between an image and the pose nearest in time [s].

    Examples
    --------
    >>> LogOptions(rotation="ur", time_unit="ms", image_times="names").max_gap_s
    0.1
    """

    poses: str = "poses.csv"
    image_times: str = "images.csv"
    images: str = "*"
    time_unit: TimeUnit = "s"
    image_time_unit: TimeUnit | None = None
    max_gap_s: float = 0.1


def read_log(
    src: str | PathLike[str],
    options: LogOptions | None = None,
    on_progress: Callable[[int], object] | None = None,
) -> PoseImageSet:
    """Data set from images with times and the log of a robot, which are joined in time.

    Parameters
    ----------
    src : path-like
        Folder that holds the images and both tables.
    options : LogOptions, optional
    on_progress : callable, optional
        Called with the number of images read.

    Returns
    -------
    PoseImageSet
        In the order of the table of images, or of their names.

    Raises
    ------
    DataSetError
        If a file is missing, damaged or inconsistent, or no image has a pose near in time.

    Warns
    -----
    ServoscopeWarning
        If anything was left out, with counts and reasons, or the clocks differ.

    Examples
    --------
    >>> options = LogOptions(rotation="ur", clock_offset="estimate")
    >>> data = read_log("my_recording", options)  # doctest: +SKIP
    """
    options = LogOptions() if options is None else options
    folder, drops = Path(src), Drops()
    check_folder(folder, options.poses)
    names, times, image_step = _read_images(folder, options)
    trajectory, pose_step = _read_trajectory(folder / options.poses, options, drops)
    images = Frames(folder, names, np.arange(len(names)), np.empty((len(names), 4, 4)), times)
    called = ("images", options.poses)
    return assemble_recording(
        images,
        trajectory,
        options,
        drops,
        "log",
        on_progress,
        step=max(image_step, pose_step),
        called=called,
    )


def _read_images(folder: Path, options: LogOptions) -> tuple[list[str], NDArray[np.float64], float]:
    """Names of the images, their times [s], and the step in which these are written [s]."""
    seconds = SECONDS[options.image_time_unit or options.time_unit]
    if options.image_times == NAMES:
        found = images_by_key(folder, options.images)
        if not found:
            raise DataSetError(f"{folder} holds no image {options.images!r}; see --images.")
        texts, names, path = list(found), list(found.values()), folder
        times = [
            parse_numbers([text], ["the time"], f"{folder / name}")[0]
            for text, name in found.items()
        ]
        step = resolution(texts, str(folder))
    else:
        check_folder(folder, options.image_times)
        path = folder / options.image_times
        rows = read_times(path, options)
        names = [relative_name(row.name or "", row.where) for row in rows]
        times = [float(row.time or 0.0) for row in rows]
        step = min(row.step for row in rows)
    check_names_differ(names, path)
    stamps = np.array(times) * seconds
    check_seconds(stamps, str(path))
    return names, stamps, step * seconds


def _read_trajectory(path: Path, options: LogOptions, drops: Drops) -> tuple[Trajectory, float]:
    """The poses in time, and the step in which their times are written [s]."""
    convention, rows = read_pose_table(path, options, key="time")
    drops.add(BAD_POSE, [Path(row.where).name for row in rows if row.numbers is None])
    rows = [row for row in rows if row.numbers is not None]
    if not rows:
        raise DataSetError(f"{path} holds no pose; its rows must be a time and a pose.")
    seconds = SECONDS[options.time_unit]
    numbers = np.array([row.numbers for row in rows], dtype=float)
    if not (convention.is_matrix or convention.has_angles):
        check_unit_length(numbers[:, 3:])
    T = poses_from_numbers(
        numbers, convention, length_unit=options.length_unit, angle_unit=options.angle_unit
    )
    T = as_T_world_cam(T, direction=options.direction, axes=options.axes)
    times = np.array([row.time for row in rows], dtype=float) * seconds
    check_seconds(times, str(path))
    trajectory, conflicts = without_equal_stamps(
        Trajectory(times, T), str(path), skip_bad=options.skip_bad
    )
    drops.add(EQUAL_STAMPS, [f"{time:.6f}" for time in conflicts])
    if not len(trajectory.times):
        raise DataSetError(f"{path} holds no pose whose time is its own; mend the times.")
    return trajectory, min(row.step for row in rows) * seconds
