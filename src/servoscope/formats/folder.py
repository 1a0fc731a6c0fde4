"""A folder of images with their poses: in a table, or in one file an image."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from os import PathLike
from pathlib import Path
from reprlib import repr as brief

import numpy as np
from numpy.typing import NDArray

from servoscope.data.images import PoseImageSet
from servoscope.errors import DataSetError, InvalidInputError
from servoscope.formats.assembly import assemble_data_set
from servoscope.formats.conventions import PoseConvention, poses_from_numbers
from servoscope.formats.frames import BAD_POSE, Drops, Frames, check_names_differ
from servoscope.formats.images import IMAGE_ENDINGS
from servoscope.formats.options import ImportOptions
from servoscope.formats.pose_table import (
    PoseRow,
    TableOptions,
    read_pose_file,
    read_pose_table,
)
from servoscope.formats.pose_text import (
    as_T_world_cam,
    check_folder,
    check_unit_length,
    relative_name,
)
from servoscope.formats.stamps import check_seconds
from servoscope.poses import inverse_transform

_NO_POSE_FILE = "without a pose"


@dataclass(frozen=True, kw_only=True)
class FolderOptions(TableOptions):
    """Options of a folder of images with poses, besides those of tables.

    Parameters
    ----------
    poses : str
        Name of the table of poses, or of one file an image with a ``*`` for what it has in common
        with the image.
    images : str
        Names of the images where the poses do not name them, with a ``*``.
    session : str, optional
        Name of a table with the pose of the part in each session; poses are then taken relative to
        the part.

    Examples
    --------
    >>> FolderOptions(rotation="matrix", poses="*.pose.txt").poses
    '*.pose.txt'
    """

    poses: str = "poses.csv"
    images: str = "*"
    session: str | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("poses", "images"):
            if getattr(self, name).count("*") > 1:
                raise InvalidInputError(
                    f"{name} must have one * at most, got {getattr(self, name)!r}."
                )


def read_folder(
    src: str | PathLike[str],
    options: ImportOptions | None = None,
    on_progress: Callable[[int], object] | None = None,
) -> PoseImageSet:
    """Data set from a folder that holds images, and their poses in a table or in files.

    By default the table is ``poses.csv``, whose header names the columns, in any order:
    ``name,tx,ty,tz,qx,qy,qz,qw`` and optionally ``time`` [s] and ``session``; other columns are
    ignored. Names are relative to the folder.

    Parameters
    ----------
    src : path-like
    options : FolderOptions or ImportOptions, optional
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
    >>> options = FolderOptions(rotation="kuka-abc", max_mm=150, max_deg=20)
    >>> data = read_folder("my_part", options)  # doctest: +SKIP
    """
    options = ImportOptions() if options is None else options
    if not isinstance(options, FolderOptions):
        common = {f.name: getattr(options, f.name) for f in fields(ImportOptions)}
        options = FolderOptions(**common)
    folder, drops = Path(src), Drops()
    parts = _parts_by_session(folder, options)
    tables = _pose_files(folder, options, parts)
    rows = [row for table in tables for row in _rows_of(folder, table, options, drops)]
    frames = _frames(folder, rows, options, drops, parts)
    return assemble_data_set(frames, options, drops, "folder", on_progress)


@dataclass(frozen=True)
class _Row:
    """An image with its pose as it is written."""

    name: str
    row: PoseRow
    convention: PoseConvention


def _pose_files(
    folder: Path, options: FolderOptions, parts: dict[str, NDArray[np.float64]] | None
) -> list[str]:
    """The tables of poses, relative to the folder: its own, or one in each session's folder."""
    if "*" in options.poses:
        check_folder(folder)
        return [options.poses]
    if parts and not (folder / options.poses).exists():
        return [f"{session}/{options.poses}" for session in parts]
    check_folder(folder, options.poses)
    return [options.poses]


def _rows_of(folder: Path, table: str, options: FolderOptions, drops: Drops) -> list[_Row]:
    if "*" in table:
        return _rows_of_files(folder, options, drops)
    path = folder / table
    convention, rows = read_pose_table(path, options)
    place = Path(table).parent.as_posix() if table != options.poses else "."
    if not rows or any(row.name is not None for row in rows):
        names = [
            relative_name(f"{place}/{row.name}" if place != "." else row.name, row.where)
            if row.name is not None
            else Path(row.where).name
            for row in rows
        ]
    else:
        names = _names_in_order(folder, place, rows, path, options)
    check_names_differ(names, path)
    return [_Row(name, row, convention) for name, row in zip(names, rows, strict=True)]


def _names_in_order(
    folder: Path, place: str, rows: Sequence[PoseRow], path: Path, options: FolderOptions
) -> list[str]:
    """The images of a table that names none: all of them, by the numbers in their names."""
    names = list(images_by_key(folder / place, options.images).values())
    if len(names) != len(rows):
        shown = f" ({names[0]}, ...)" if names else ""
        raise DataSetError(
            f"{path} names no images and has {len(rows)} poses, but {folder / place} holds "
            f"{len(names)} images {options.images!r}{shown}; name them in a column, or choose them "
            "with --images."
        )
    return [relative_name(f"{place}/{name}", str(path)) for name in names]


def _rows_of_files(folder: Path, options: FolderOptions, drops: Drops) -> list[_Row]:
    """One file an image: what the ``*`` stands for joins them."""
    convention = options.convention
    if convention is None:
        raise DataSetError(
            f"{folder}: say with --rotation what the files {options.poses!r} hold; matrix for "
            "3 x 4 or 4 x 4 numbers."
        )
    images, poses = images_by_key(folder, options.images), _by_key(folder, options.poses)
    images = {key: name for key, name in images.items() if name not in poses.values()}
    if not poses:
        raise DataSetError(f"{folder} holds no file {options.poses!r}; name them with --poses.")
    alone = [name for key, name in poses.items() if key not in images]
    if alone and not options.skip_bad:
        like = f"images are like {next(iter(images.values()))}" if images else "there are none"
        raise DataSetError(
            f"{folder / alone[0]} has no image {options.images!r} of its name ({len(alone)} such "
            f"files; {like}); name images with --images, or leave poses out with --skip-bad."
        )
    drops.add(_NO_POSE_FILE, [name for key, name in images.items() if key not in poses])
    drops.add("poses without an image", alone)
    rows = []
    for key in (key for key in poses if key in images):
        path = folder / poses[key]
        try:
            numbers = read_pose_file(path, convention, options)
        except DataSetError:
            if not options.skip_bad:
                raise
            numbers = None
        name = relative_name(images[key], str(path))
        rows.append(_Row(name, PoseRow(str(path), name, numbers), convention))
    return rows


def images_by_key(folder: Path, pattern: str) -> dict[str, str]:
    """Names of images that fit a pattern, by what its ``*`` stands for, in natural order."""
    if Path(pattern).suffix not in ("", ".*"):
        return _by_key(folder, pattern)
    found = _by_key(folder, pattern if "*" in pattern else f"{pattern}/*")
    endings = {
        key: next((e for e in IMAGE_ENDINGS if key.lower().endswith(e)), "") for key in found
    }
    return {key[: -len(end)]: found[key] for key, end in endings.items() if end}


def _by_key(folder: Path, pattern: str) -> dict[str, str]:
    before, _, after = pattern.replace("\\", "/").removeprefix("./").partition("*")
    fits = re.compile(f"{re.escape(before)}([^/]+){re.escape(after)}")
    place = folder / before.rpartition("/")[0]
    try:
        found = place.rglob("*") if "/" in after else place.glob("*")
        files = [file.relative_to(folder).as_posix() for file in found]
    except OSError as error:
        raise DataSetError(f"{place} cannot be read ({error.strerror}).") from error
    matches = {m[1]: m[0] for name in files if (m := fits.fullmatch(name)) and m[1][0] != "."}
    return dict(sorted(matches.items(), key=lambda item: natural(item[1])))


def natural(name: str) -> list[tuple[int, str]]:
    """A key of names that puts 2.png before 10.png."""
    parts = re.split(r"(\d+)", name)
    return [(int(part), "") if i % 2 else (-1, part) for i, part in enumerate(parts)]


def _frames(
    folder: Path,
    rows: list[_Row],
    options: FolderOptions,
    drops: Drops,
    parts: dict[str, NDArray[np.float64]] | None,
) -> Frames:
    usable = np.array([row.row.numbers is not None for row in rows], dtype=bool)
    drops.add(BAD_POSE, [row.name for row, use in zip(rows, usable, strict=True) if not use])
    kept = [row for row, use in zip(rows, usable, strict=True) if use]
    T = np.empty((0, 4, 4))
    if kept:
        numbers = np.array([row.row.numbers for row in kept])
        T = as_T_world_cam(
            _poses(numbers, kept[0].convention, options),
            direction=options.direction,
            axes=options.axes,
        )
    times = [row.row.time for row in kept]
    if parts is not None:
        sessions = [_session_of(row, parts, options) for row in kept]
        T = np.array(
            [inverse_transform(parts[s]) @ T_i for s, T_i in zip(sessions, T, strict=True)]
        )
        times = _one_after_the_other(times, sessions)
    is_timed = bool(kept) and all(time is not None for time in times)
    seconds = np.array(times, dtype=float) if is_timed else None
    if seconds is not None:
        check_seconds(seconds, f"{folder / options.poses}, column time")
    return Frames(folder, [row.name for row in kept], np.flatnonzero(usable), T, seconds)


def _poses(
    numbers: NDArray[np.float64], convention: PoseConvention, options: FolderOptions
) -> NDArray[np.float64]:
    if not (convention.is_matrix or convention.has_angles):
        check_unit_length(numbers[:, 3:])
    return poses_from_numbers(
        numbers, convention, length_unit=options.length_unit, angle_unit=options.angle_unit
    )


def _parts_by_session(
    folder: Path, options: FolderOptions
) -> dict[str, NDArray[np.float64]] | None:
    """The pose of the part in each session, in the world of the poses; None without sessions."""
    if options.session is None:
        return None
    check_folder(folder, options.session)
    path = folder / options.session
    strict = replace(options, skip_bad=False, columns=None, name_column=None)
    convention, rows = read_pose_table(path, strict, key="session")
    names = [relative_name(row.name or "", row.where) for row in rows]
    check_names_differ(names, path)
    numbers = np.array([row.numbers for row in rows], dtype=float)
    if not len(numbers):
        raise DataSetError(f"{path} holds no session; write one row a session.")
    return dict(zip(names, _poses(numbers, convention, options), strict=True))


def _session_of(row: _Row, parts: dict[str, NDArray[np.float64]], options: FolderOptions) -> str:
    """The session of an image: of its row, or the first folder of its name."""
    session = row.row.session if row.row.session is not None else row.name.partition("/")[0]
    if session not in parts:
        raise DataSetError(
            f"{row.row.where}: the session of {row.name} is {brief(session)}, but "
            f"{options.session} holds {', '.join(list(parts)[:5])}; write a column 'session', or "
            "one folder a session."
        )
    return session


def _one_after_the_other(times: list[float | None], sessions: list[str]) -> list[float | None]:
    """Times of sessions that overlap, as of clocks that began anew, put one after the other."""
    if any(time is None for time in times):
        return [None] * len(times)
    known, shifted, end = np.array(times, dtype=float), np.array(times, dtype=float), -np.inf
    for session in dict.fromkeys(sessions):
        own = np.array([s == session for s in sessions])
        if known[own].min() <= end:
            shifted[own] += end + 1.0 - known[own].min()
        end = float(shifted[own].max())
    return [float(time) for time in shifted]
