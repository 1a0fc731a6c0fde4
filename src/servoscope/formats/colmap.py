"""A reconstruction of COLMAP, as text or binary: ``images.txt`` or ``images.bin``, and images."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from reprlib import repr as brief

import numpy as np

from servoscope.data.images import PoseImageSet
from servoscope.errors import DataSetError, ServoscopeWarning
from servoscope.formats.assembly import assemble_data_set
from servoscope.formats.colmap_binary import camera_lines, image_fields
from servoscope.formats.conventions import CONVENTIONS, poses_from_numbers
from servoscope.formats.frames import BAD_POSE, Drops, Frames, check_names_differ
from servoscope.formats.options import Direction
from servoscope.formats.pose_text import (
    as_T_world_cam,
    check_folder,
    check_unit_length,
    parse_pose,
    relative_name,
)
from servoscope.formats.scaled import ScaledOptions
from servoscope.storage.reading import LONGEST_LINE, check_regular, words

_COLUMNS = "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME"
_PLACES = ("", "sparse/0", "sparse", "colmap/sparse/0", "dense/sparse")
_IMAGES = ("images", "input", "rgb")


@dataclass(frozen=True, kw_only=True)
class ColmapOptions(ScaledOptions):
    """Options of a reconstruction of COLMAP, besides those of every reconstruction.

    Parameters
    ----------
    model : str, optional
        Folder within SRC that holds images.txt or images.bin; by default SRC itself or sparse/0.
    images : str, optional
        Folder within SRC that the names of the images are relative to; by default images, or SRC.
    direction : {"world-to-camera", "camera-to-world"}
        What the poses map; COLMAP writes world to camera.

    Examples
    --------
    >>> ColmapOptions(model="sparse/1", scale=0.21).direction
    'world-to-camera'
    """

    model: str | None = None
    images: str | None = None
    direction: Direction = "world-to-camera"


def read_colmap(
    src: str | PathLike[str],
    options: ColmapOptions | None = None,
    on_progress: Callable[[int], object] | None = None,
) -> PoseImageSet:
    """Data set from a reconstruction that COLMAP wrote.

    ``images.txt`` holds a line ``IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME`` for each image,
    and after each a line of points, which is not read; where there is none, ``images.bin`` holds
    the same. Of ``cameras.txt`` or ``cameras.bin`` the models are noted.

    Parameters
    ----------
    src : path-like
    options : ColmapOptions, optional
    on_progress : callable, optional
        Called with the number of images read.

    Returns
    -------
    PoseImageSet
        In the order of that file.

    Raises
    ------
    DataSetError
        If a file is missing, damaged or inconsistent.

    Warns
    -----
    ServoscopeWarning
        If the scale is not said, or anything was left out.

    References
    ----------
    J. L. Schönberger, J.-M. Frahm, "Structure-from-motion revisited", CVPR 2016.

    Examples
    --------
    >>> data = read_colmap("part", ColmapOptions(scale=0.21))  # doctest: +SKIP
    """
    options = ColmapOptions() if options is None else options
    folder, drops = Path(src), Drops()
    check_folder(folder)
    model = _model(folder, options)
    names, numbers, cameras = _read_images(model, options, drops)
    place = options.images
    if place is None:
        place = next((name for name in _IMAGES if (folder / name).is_dir()), "")
    usable = np.isfinite(numbers).all(axis=1)
    check_unit_length(numbers[usable, 3:])
    T = poses_from_numbers(numbers[usable], CONVENTIONS["wxyz"], length_unit="m")
    T[:, :3, 3] *= options.metres(folder)
    frames = Frames(
        folder / place,
        [name for name, use in zip(names, usable, strict=True) if use],
        np.flatnonzero(usable),
        as_T_world_cam(T, direction=options.direction, axes=options.axes),
    )
    if len(cameras) > 1:
        warnings.warn(
            f"{folder}: the images are of {len(cameras)} cameras; one lens belongs to one model: "
            "leave out those of the others.",
            ServoscopeWarning,
            stacklevel=2,
        )
    facts = {"cameras": _read_cameras(model, cameras)}
    return assemble_data_set(frames, options, drops, "colmap", on_progress, facts)


def _model(folder: Path, options: ColmapOptions) -> Path:
    """The path of ``images.txt``, or of ``images.bin`` where there is none."""
    places = _PLACES if options.model is None else (options.model,)
    for name in ("images.txt", "images.bin"):
        for place in places:
            if (path := folder / place / name).exists():
                return path
    raise DataSetError(
        f"{folder} holds no images.txt or images.bin in {', '.join(p or '.' for p in places)}; "
        "name its folder with --model."
    )


def _read_images(
    path: Path, options: ColmapOptions, drops: Drops
) -> tuple[list[str], np.ndarray, set[str]]:
    """Names, poses (n, 7) with NaN where one is left out, and the cameras' numbers."""
    names, numbers, cameras = [], [], set()
    for where, fields in image_fields(path) if path.suffix == ".bin" else _text_fields(path):
        names.append(relative_name(fields[9], where))
        cameras.add(fields[8])
        try:
            pose = [*fields[5:8], *fields[1:5]]
            numbers.append(parse_pose(pose, CONVENTIONS["wxyz"], where, "m"))
        except DataSetError:
            if not options.skip_bad:
                raise
            drops.add(BAD_POSE, names[-1:])
            numbers.append([np.nan] * 7)
    if not names:
        raise DataSetError(f"{path} names no image; its lines must be {_COLUMNS!r}.")
    check_names_differ(names, path)
    return names, np.array(numbers), cameras


def _text_fields(path: Path) -> Iterator[tuple[str, list[str]]]:
    """Where each image stands in ``images.txt``, and its fields."""
    for where, line in _pose_lines(path):
        fields = line.split(maxsplit=9)
        if len(fields) != 10:
            raise DataSetError(f"{where}: must be {_COLUMNS!r}, got {brief(line)}.")
        yield where, fields


def _pose_lines(path: Path) -> Iterator[tuple[str, str]]:
    """Every other line, and where it stands; those of points may be of any length."""
    check_regular(path, DataSetError)
    try:
        with open(path, encoding="utf-8-sig") as file:
            number, is_points = 0, False
            while line := file.readline(LONGEST_LINE):
                number += 1
                is_whole = line.endswith("\n") or len(line) < LONGEST_LINE
                if not is_points and not is_whole:
                    raise DataSetError(f"{path}, line {number} is too long for a pose.")
                while not is_whole:
                    rest = file.readline(LONGEST_LINE)
                    is_whole = rest.endswith("\n") or len(rest) < LONGEST_LINE
                text = line.strip()
                if text.startswith("#") or (not is_points and not text):
                    continue
                if not is_points:
                    yield f"{path}, line {number}", text
                is_points = not is_points
    except UnicodeDecodeError as error:
        raise DataSetError(f"{path} is no text; a binary model is called images.bin.") from error
    except OSError as error:
        raise DataSetError(f"{path} cannot be read ({words(error)}).") from error


def _read_cameras(images: Path, used: set[str]) -> list[str]:
    """What the file beside that of the images says of the cameras that are used, if it is there."""
    path = images.with_stem("cameras")
    if not path.exists():
        return []
    if path.suffix == ".bin":
        return camera_lines(path, used)
    check_regular(path, DataSetError, LONGEST_LINE * 16)
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    return [line.strip()[:200] for line in lines if line.split() and line.split()[0] in used]
