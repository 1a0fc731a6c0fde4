"""A folder of images with ``poses.csv``."""

from __future__ import annotations

import csv
from array import array
from collections.abc import Callable, Iterator
from os import PathLike
from pathlib import Path
from reprlib import repr as brief
from typing import Any, NoReturn

import numpy as np

from servoscope.data.images import PoseImageSet
from servoscope.errors import DataSetError
from servoscope.formats.assembly import assemble_data_set
from servoscope.formats.frames import BAD_POSE, Drops, Frames, check_names_differ
from servoscope.formats.options import ImportOptions
from servoscope.formats.pose_text import (
    T_world_cam_from_numbers,
    check_folder,
    other_separators,
    parse_numbers,
    parse_pose,
    relative_name,
)
from servoscope.formats.stamps import check_seconds
from servoscope.storage.reading import read_lines

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
    reader = csv.reader(read_lines(path, DataSetError, newline=""))
    names, usable, numbers = [], [], array("d")
    try:
        header = [column.strip().lower() for column in next(reader, [])]
        columns = _check_header(header, path)
        for where, cells in _read_rows(reader, header, columns, path, options):
            names.append(relative_name(cells[0], where) if cells else Path(where).name)
            usable.append(len(cells) == len(columns))
            if not usable[-1]:
                continue
            try:
                row = parse_pose(cells[1:8], POSE_COLUMNS, where, options.units)
                row += parse_numbers(cells[8:], columns[8:], where)
            except DataSetError:
                if not options.skip_bad:
                    raise
                usable[-1] = False
                continue
            numbers.extend(row)
    except csv.Error as error:
        raise DataSetError(f"{path}, line {reader.line_num}: not CSV ({error}).") from error
    check_names_differ(names, path)
    drops.add(BAD_POSE, [name for name, use in zip(names, usable, strict=True) if not use])
    table = np.array(numbers).reshape(-1, len(columns) - 1)
    if "time" in columns and len(table):
        check_seconds(table[:, 7], f"{path}, column time")
    return Frames(
        folder=folder,
        names=[name for name, use in zip(names, usable, strict=True) if use],
        numbers=np.flatnonzero(usable),
        T_world_cam=T_world_cam_from_numbers(
            table[:, :7], direction=options.direction, units=options.units, axes=options.axes
        ),
        times=table[:, 7] if "time" in columns else None,
    )


def _read_rows(
    reader: Any, header: list[str], columns: list[str], path: Path, options: ImportOptions
) -> Iterator[tuple[str, list[str]]]:
    """Where each row stands, and its cells in the order of `columns`.

    In a row of another length than the header's, cells would stand under wrong names. One that is
    too short may be left out: of it the name comes back alone, or nothing.
    """
    places = [header.index(column) for column in columns]
    for row in reader:
        where = f"{path}, line {reader.line_num}"
        while len(row) > len(header) and not row[-1].strip():
            row.pop()
        if len(row) > len(header) or (0 < len(row) < len(header) and not options.skip_bad):
            _refuse_length(row, header, where)
        if row:
            used = places if len(row) == len(header) else places[:1]
            yield where, [row[place] for place in used if place < len(row)]


def _refuse_length(row: list[str], header: list[str], where: str) -> NoReturn:
    cells = f"{len(row)} cell{'s' * (len(row) != 1)}"
    hint = other_separators(row[0]) if len(row) == 1 else ""
    if len(row) > len(header):
        hint = ": decimal commas, or a comma too many? Write decimals with a point"
    raise DataSetError(
        f"{where} has {cells}, but the header has {len(header)} columns{hint}; divide all lines by "
        "the same number of commas."
    )


def _check_header(header: list[str], path: Path) -> list[str]:
    wanted = ["name", *POSE_COLUMNS]
    if not header:
        raise DataSetError(f"{path} is empty; it must begin with the header {','.join(wanted)}.")
    missing = [column for column in wanted if column not in header]
    repeated = [column for column in (*wanted, "time") if header.count(column) > 1]
    if missing or repeated:
        problem = f"lacks {', '.join(missing)}" if missing else f"repeats {', '.join(repeated)}"
        raise DataSetError(
            f"{path}: the header must hold {','.join(wanted)}, but {brief(','.join(header))} "
            f"{problem}{other_separators(header[0]) if len(header) == 1 else ''}."
        )
    return [*wanted, "time"] if "time" in header else wanted
