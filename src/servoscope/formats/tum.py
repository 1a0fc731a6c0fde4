"""A TUM sequence: ``rgb.txt`` and ``groundtruth.txt``."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from reprlib import repr as brief

import numpy as np

from servoscope.data.images import PoseImageSet
from servoscope.errors import DataSetError
from servoscope.formats.conventions import CONVENTIONS
from servoscope.formats.frames import (
    BAD_POSE,
    EQUAL_STAMPS,
    Drops,
    Frames,
    check_names_differ,
)
from servoscope.formats.options import QuaternionOrder
from servoscope.formats.pose_text import (
    T_world_cam_from_numbers,
    check_folder,
    check_pose_header,
    other_separators,
    parse_numbers,
    parse_pose,
    relative_name,
)
from servoscope.formats.recordings import RecordingOptions, assemble_recording
from servoscope.formats.stamps import (
    Trajectory,
    check_seconds,
    resolution,
    without_equal_stamps,
)
from servoscope.storage.reading import read_lines

_COLUMNS = ("timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw")


@dataclass(frozen=True, kw_only=True)
class TumOptions(RecordingOptions):
    """Options of a TUM sequence, besides those of every recording.

    Parameters
    ----------
    quaternion_order : {"xyzw", "wxyz"}
        Order of the quaternion: scalar last, as the format has it, or scalar first.

    Examples
    --------
    >>> TumOptions(reference_index=144, max_mm=150, max_deg=20).max_gap_s
    0.02
    """

    quaternion_order: QuaternionOrder = "xyzw"


def read_tum(
    src: str | PathLike[str],
    options: TumOptions | None = None,
    on_progress: Callable[[int], object] | None = None,
) -> PoseImageSet:
    """Data set from a TUM sequence.

    ``rgb.txt`` has lines ``timestamp filename``, ``groundtruth.txt`` has lines ``timestamp tx ty
    tz qx qy qz qw``, in any order; lines that begin with ``#`` are comments. Each image gets the
    pose of its time.

    Parameters
    ----------
    src : path-like
    options : TumOptions, optional
    on_progress : callable, optional
        Called with the number of images read.

    Returns
    -------
    PoseImageSet
        In the order of ``rgb.txt``. The reference frame is one of them, with displacement zero.

    Raises
    ------
    DataSetError
        If a file is missing, damaged or inconsistent, stamps are not seconds or stand for several
        poses, column names in a comment contradict the order of the quaternion, or no image has a
        pose near in time.

    Warns
    -----
    ServoscopeWarning
        If anything was left out, with counts and reasons, or is doubtful.

    Notes
    -----
    Between two poses the camera is taken to move at constant velocity and to turn at constant
    angular velocity about a fixed axis.

    References
    ----------
    J. Sturm, N. Engelhard, F. Endres, W. Burgard, D. Cremers, "A benchmark for the evaluation of
    RGB-D SLAM systems", IROS 2012.

    Examples
    --------
    >>> options = TumOptions(reference_index=144, max_mm=150, max_deg=20)
    >>> data = read_tum("rgbd_dataset_freiburg1_rpy", options)  # doctest: +SKIP
    """
    options = TumOptions() if options is None else options
    folder, drops = Path(src), Drops()
    check_folder(folder, "rgb.txt", "groundtruth.txt")
    names, times, image_step = _read_image_list(folder / "rgb.txt")
    trajectory, pose_step = _read_trajectory(folder / "groundtruth.txt", options, drops)
    images = Frames(folder, names, np.arange(len(names)), np.empty((len(names), 4, 4)), times)
    return assemble_recording(
        images,
        trajectory,
        options,
        drops,
        "tum",
        on_progress,
        step=max(image_step, pose_step),
        called=("images of rgb.txt", "groundtruth.txt"),
    )


def _read_image_list(path: Path) -> tuple[list[str], np.ndarray, float]:
    """Names of the images, their stamps [s], and the step in which these are written [s]."""
    names, steps, times = [], [], []
    for where, line in _lines(path):
        fields = line.split(maxsplit=1)
        if len(fields) != 2:
            raise DataSetError(
                f"{where}: must be 'timestamp filename', got {brief(line)}{other_separators(line)}."
            )
        times += parse_numbers(fields[:1], _COLUMNS[:1], where)
        steps.append(resolution(fields[:1], where))
        names.append(relative_name(fields[1], where))
    if not names:
        raise DataSetError(f"{path} names no image; its lines must be 'timestamp filename'.")
    check_names_differ(names, path)
    check_seconds(np.array(times), str(path))
    return names, np.array(times), min(steps)


def _read_trajectory(path: Path, options: TumOptions, drops: Drops) -> tuple[Trajectory, float]:
    """The poses in time, and the step in which their stamps are written [s]."""
    steps, numbers = [], array("d")
    convention = CONVENTIONS[options.quaternion_order]
    for where, line in _lines(path, options.quaternion_order):
        fields = line.split()
        try:
            if len(fields) != 8:
                raise DataSetError(
                    f"{where}: must be {' '.join(_COLUMNS)!r}, got {brief(line)}"
                    f"{other_separators(line) if len(fields) == 1 else ''}."
                )
            row = parse_numbers(fields[:1], _COLUMNS[:1], where)
            row += parse_pose(fields[1:], convention, where, options.length_unit)
            step = resolution(fields[:1], where)
        except DataSetError:
            check_pose_header(line, options.quaternion_order, where)
            if not options.skip_bad:
                raise
            drops.add(BAD_POSE, [Path(where).name])
            continue
        steps.append(step)
        numbers.extend(row)
    if not steps:
        raise DataSetError(f"{path} holds no pose; its lines must be {' '.join(_COLUMNS)!r}.")
    table = np.array(numbers).reshape(-1, len(_COLUMNS))
    check_seconds(table[:, 0], str(path))
    T_world_cam = T_world_cam_from_numbers(
        table[:, 1:],
        direction=options.direction,
        units=options.length_unit,
        quaternion_order=options.quaternion_order,
        axes=options.axes,
    )
    trajectory, conflicts = without_equal_stamps(
        Trajectory(table[:, 0], T_world_cam), str(path), skip_bad=options.skip_bad
    )
    drops.add(EQUAL_STAMPS, [f"{time:.6f}" for time in conflicts])
    if not len(trajectory.times):
        raise DataSetError(f"{path} holds no pose whose stamp is its own; mend the stamps.")
    return trajectory, min(steps)


def _lines(
    path: Path, quaternion_order: QuaternionOrder | None = None
) -> Iterator[tuple[str, str]]:
    """The lines that hold something, and where each stands; comments are checked and left out."""
    for number, line in enumerate(read_lines(path, DataSetError), start=1):
        where, line = f"{path}, line {number}", line.strip()
        if line.startswith("#") and quaternion_order is not None:
            check_pose_header(line, quaternion_order, where)
        if line and not line.startswith("#"):
            yield where, line
