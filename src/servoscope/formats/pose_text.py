"""Poses written as text: separators, numbers, names of columns, and pose conventions."""

from __future__ import annotations

import math
import os
import posixpath
import re
import warnings
from collections.abc import Sequence
from pathlib import Path
from reprlib import repr as brief
from unicodedata import normalize

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.errors import DataSetError, ServoscopeWarning
from servoscope.formats.conventions import (
    MATRIX_COLUMNS,
    METRES,
    AngleUnit,
    PoseConvention,
    problem_of_pose,
)
from servoscope.formats.options import Axes, Direction, QuaternionOrder, Units
from servoscope.poses import inverse_transform, poses_from_quaternions

_OPENCV_FROM = {"opencv": np.eye(4), "opengl": np.diag([1.0, -1.0, -1.0, 1.0])}
_LENGTH_TOLERANCE = 0.01


def T_world_cam_from_numbers(
    numbers: ArrayLike,
    *,
    direction: Direction = "camera-to-world",
    units: Units = "m",
    quaternion_order: QuaternionOrder = "xyzw",
    axes: Axes = "opencv",
) -> NDArray[np.float64]:
    """Camera poses in servoscope's convention from translations and quaternions in any other.

    Parameters
    ----------
    numbers : array of shape (n, 7)
        Translation, then quaternion.
    direction : {"camera-to-world", "world-to-camera"}
        What the given transforms map.
    units : {"m", "mm"}
        Of the translations.
    quaternion_order : {"xyzw", "wxyz"}
        Scalar last or scalar first.
    axes : {"opencv", "opengl"}
        Camera axes of the given transforms: x right, y down, z forward; or x right, y up,
        z backward.

    Returns
    -------
    T_world_cam : ndarray of shape (n, 4, 4)
        Camera to world, [m], with OpenCV axes.

    Raises
    ------
    InvalidInputError
        If a number is not finite or a quaternion has zero length.

    Warns
    -----
    ServoscopeWarning
        If quaternions are so far from unit length that something else may stand there.

    Examples
    --------
    A world origin that the camera sees 550 mm ahead:

    >>> T = T_world_cam_from_numbers(
    ...     [[0, 0, 550, 0, 0, 0, 1]], direction="world-to-camera", units="mm"
    ... )
    >>> float(T[0, 2, 3])
    -0.55
    """
    numbers = np.asarray(numbers, dtype=float).reshape(-1, 7)
    quaternion = numbers[:, 3:]
    if quaternion_order == "wxyz":
        quaternion = np.roll(quaternion, -1, axis=1)
    check_unit_length(quaternion)
    T = poses_from_quaternions(numbers[:, :3] * METRES[units], quaternion)
    return as_T_world_cam(T, direction=direction, axes=axes)


def as_T_world_cam(
    T: NDArray[np.float64], *, direction: Direction, axes: Axes
) -> NDArray[np.float64]:
    """Camera poses in servoscope's convention from those of shape (n, 4, 4) in another."""
    return (inverse_transform(T) if direction == "world-to-camera" else T) @ _OPENCV_FROM[axes]


def check_unit_length(quaternion: NDArray[np.float64]) -> None:
    """Warn of quaternions so far from unit length that something else may stand there."""
    lengths = np.linalg.norm(quaternion, axis=1)
    odd = np.abs(lengths - 1) > _LENGTH_TOLERANCE
    if odd.any():
        warnings.warn(
            f"{odd.sum()} of {len(odd)} quaternions are not of unit length "
            f"({lengths.min():.3g} to {lengths.max():.3g}); they were normalised, but check that "
            "the columns are quaternions.",
            ServoscopeWarning,
            stacklevel=3,
        )


_AXIS = re.compile(r"(?:[\w./]*[_./])?(?:[tpqr]|pos|quat|rot)?([wxyz])")
_PART_OF_QUATERNION = re.compile(r"q\w*[wxyz]")
_ORDERS = ("xyzw", "wxyz")


def check_pose_header(line: str, quaternion_order: str, where: str) -> None:
    """Check that column names, if a line holds them, do not contradict what is read.

    Names such as ``tx``, ``q_w``, ``pose.orientation.x`` or ``q_RS_w []`` are known by the axis
    that they end with. A line holds names if it has seven of them, four of a quaternion, or the
    word ``xyzw`` or ``wxyz``.

    Raises
    ------
    DataSetError
        If seven names of axes are in another order than translation and quaternion.

    Examples
    --------
    >>> check_pose_header("# timestamp tx ty tz qx qy qz qw", "xyzw", "groundtruth.txt, line 1")
    """
    words = re.split(r"[\s,;|:=()\[\]]+", line.lower().lstrip("#%/ "))
    names = [word for word in words if _AXIS.fullmatch(word)][:7]
    letters = "".join(name[-1] for name in names)
    if sorted(letters) == sorted("xyzwxyz"):
        is_as_read = letters == "xyz" + quaternion_order
        order = letters[3:] if letters.startswith("xyz") else ""
    else:
        names = [word for word in words if _PART_OF_QUATERNION.fullmatch(word)]
        names = names if len(names) == 4 else [word for word in words if word in _ORDERS][:1]
        order = "".join(name[-1] for name in names) if len(names) == 4 else "".join(names)
        is_as_read = order == quaternion_order or sorted(order) != sorted("wxyz")
    if is_as_read:
        return
    advice = "put the columns in that order"
    if order in _ORDERS:
        advice = f"say --quaternion-order {order}"
    raise DataSetError(
        f"{where}: the columns are called {' '.join(names)!r}, but are read as tx ty tz and a "
        f"quaternion {quaternion_order}; {advice}, or mend the line."
    )


_SEPARATORS = {";": "semicolons", "\t": "tabs", "|": "bars", ",": "commas", " ": "spaces"}


def check_folder(folder: Path, *wanted: str) -> None:
    """Check that a folder holds the wanted files.

    Raises
    ------
    DataSetError
        If the folder or one of the files is missing.
    """
    if not folder.is_dir():
        what = "is a file" if folder.exists() else "does not exist"
        raise DataSetError(f"{folder} {what}; name the folder that holds {' and '.join(wanted)}.")
    try:
        is_empty = not any(folder.iterdir())
    except OSError as error:
        raise DataSetError(f"{folder} cannot be read ({error.strerror}).") from error
    if is_empty:
        raise DataSetError(f"{folder} is empty; it must hold {' and '.join(wanted)}.")
    for name in wanted:
        if not os.path.lexists(folder / name):
            raise DataSetError(f"{folder / name} is missing; write it or name another folder.")


def parse_numbers(texts: Sequence[str], columns: Sequence[str], where: str) -> list[float]:
    """Finite numbers from the texts of the given columns.

    Parameters
    ----------
    texts, columns : sequences of n str
    where : str
        File and line, for errors.

    Raises
    ------
    DataSetError
        If a text is not a finite number.
    """
    numbers = [_number(text) for text in texts]
    for number, text, column in zip(numbers, texts, columns, strict=True):
        if not math.isfinite(number):
            with_point = math.isfinite(_number(text.replace(",", ".")))
            hint = "mend the line"
            if with_point:
                hint = "write decimals with a point (or say --decimal comma, of tables)"
            raise DataSetError(
                f"{where}: {column} must be a finite number, got {brief(text.strip())}; {hint}, "
                "or leave it out with --skip-bad."
            )
    return numbers


def parse_pose(
    texts: Sequence[str],
    convention: PoseConvention,
    where: str,
    length_unit: Units,
    angle_unit: AngleUnit | None = None,
) -> list[float]:
    """The numbers of a pose, in the order of its convention; those of a matrix row by row.

    Raises
    ------
    DataSetError
        If one is not a finite number, or they are no pose.
    """
    columns = MATRIX_COLUMNS if convention.is_matrix else convention.columns
    numbers = parse_numbers(texts, columns, where)
    problem = problem_of_pose(numbers, convention, length_unit=length_unit, angle_unit=angle_unit)
    if problem:
        raise DataSetError(f"{where}: {problem}, or leave it out with --skip-bad.")
    return numbers


def other_separators(text: str) -> str:
    """What else than the wanted separator may divide the columns of a line, in words.

    Examples
    --------
    >>> other_separators("name;tx;ty")
    " (it is divided by semicolons, ';')"
    """
    found = [f"{name}, {sign!r}" for sign, name in _SEPARATORS.items() if sign in text.strip()]
    return f" (it is divided by {found[0]})" if found else ""


def relative_name(text: str, where: str) -> str:
    r"""Name of a file relative to the folder, with ``/`` between its parts, in Unicode's form NFC.

    Raises
    ------
    DataSetError
        If it is empty, or leads out of the folder.

    Examples
    --------
    >>> relative_name(r".\left\0001.png", "poses.csv, line 2")
    'left/0001.png'
    """
    name = normalize("NFC", posixpath.normpath(text.strip().replace("\\", "/")))
    if name == ".":
        raise DataSetError(f"{where}: the name of the image is empty.")
    if name.startswith("/") or name[1:2] == ":" or name.split("/", 1)[0] == "..":
        raise DataSetError(
            f"{where}: {text.strip()!r} leads out of the folder; name images relative to it."
        )
    return name


def _number(text: str) -> float:
    """The number that is written, NaN if it is none; 1_000 is none."""
    try:
        return math.nan if "_" in text else float(text)
    except ValueError:
        return math.nan
