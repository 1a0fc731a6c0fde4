"""A folder of images with ``poses.csv``."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable
from os import PathLike
from pathlib import Path

import numpy as np

from servoscope.dataset import PoseImageSet
from servoscope.errors import DataSetError
from servoscope.formats.assembly import assemble_data_set
from servoscope.formats.conventions import T_world_cam_from_numbers
from servoscope.formats.drops import BAD_POSE, Drops
from servoscope.formats.frames import Frames, check_names_differ
from servoscope.formats.options import ImportOptions
from servoscope.formats.pose_text import (
    check_folder,
    parse_numbers,
    parse_pose,
    read_text,
    relative_name,
)

POSE_COLUMNS = ("tx", "ty", "tz", "qx", "qy", "qz", "qw")


def read_folder(
    src: str | PathLike[str],
    options: ImportOptions | None = None,
    on_progress: Callable[[int], object] | None = None,
) -> PoseImageSet:
    """Data set from a folder that holds images and a ``poses.csv`` which names them.

    The header names the columns, in any order: ``name,tx,ty,tz,qx,qy,qz,qw`` and optionally
    ``time`` [s]; other columns are ignored. Names are relative to the folder.

    Parameters
    ----------
    src : path-like
    options : ImportOptions, optional
    on_progress : callable, optional
        Called with the number of images read.

    Returns
    -------
    PoseImageSet
        In the order of the rows. The reference frame is one of them, with displacement zero.

    Raises
    ------
    DataSetError
        If a file is missing, damaged or inconsistent.

    Warns
    -----
    ServoscopeWarning
        If anything was left out, with counts and reasons.

    Examples
    --------
    >>> from servoscope.formats.options import ImportOptions
    >>> options = ImportOptions(units="mm", max_mm=150, max_deg=20)
    >>> data = read_folder("my_part", options)  # doctest: +SKIP
    """
    options = ImportOptions() if options is None else options
    folder, drops = Path(src), Drops()
    check_folder(folder, "poses.csv")
    frames = _read_frames(folder, options, drops)
    return assemble_data_set(frames, options, drops, "folder", on_progress)


def _read_frames(folder: Path, options: ImportOptions, drops: Drops) -> Frames:
    path = folder / "poses.csv"
    columns, rows = _read_rows(path)
    names = [relative_name(row["name"], where) for where, row in rows]
    check_names_differ(names, path)
    numbers, usable = [], np.zeros(len(rows), dtype=bool)
    for i, (where, row) in enumerate(rows):
        try:
            pose = parse_pose([row[column] for column in POSE_COLUMNS], POSE_COLUMNS, where)
            time = parse_numbers([row[column] for column in columns[8:]], columns[8:], where)
        except DataSetError:
            if not options.skip_bad:
                raise
            continue
        usable[i] = True
        numbers.append(pose + time)
    drops.add(BAD_POSE, [name for name, use in zip(names, usable, strict=True) if not use])
    table = np.array(numbers, dtype=float).reshape(-1, len(columns) - 1)
    return Frames(
        folder=folder,
        names=[name for name, use in zip(names, usable, strict=True) if use],
        numbers=np.flatnonzero(usable),
        T_world_cam=T_world_cam_from_numbers(
            table[:, :7], direction=options.direction, units=options.units, axes=options.axes
        ),
        times=table[:, 7] if "time" in columns else None,
    )


def _read_rows(path: Path) -> tuple[list[str], list[tuple[str, dict[str, str]]]]:
    reader = csv.DictReader(io.StringIO(read_text(path), newline=""), restval="")
    try:
        header = [column.strip().lower() for column in reader.fieldnames or ()]
        columns = _check_header(header, path)
        reader.fieldnames = header
        return columns, [(f"{path}, line {reader.line_num}", row) for row in reader]
    except csv.Error as error:
        raise DataSetError(f"{path}, line {reader.line_num}: not CSV ({error}).") from error


def _check_header(header: list[str], path: Path) -> list[str]:
    wanted = ["name", *POSE_COLUMNS]
    if not header:
        raise DataSetError(f"{path} is empty; it must begin with the header {','.join(wanted)}.")
    missing = [column for column in wanted if column not in header]
    repeated = [column for column in (*wanted, "time") if header.count(column) > 1]
    if missing or repeated:
        problem = f"lacks {', '.join(missing)}" if missing else f"repeats {', '.join(repeated)}"
        raise DataSetError(
            f"{path}: the header must hold {','.join(wanted)}, but {','.join(header)!r} {problem}."
        )
    return [*wanted, "time"] if "time" in header else wanted
