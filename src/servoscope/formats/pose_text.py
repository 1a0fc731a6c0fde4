"""Poses written as text: lines, numbers, and what makes a pose unusable."""

from __future__ import annotations

import math
import posixpath
from collections.abc import Sequence
from pathlib import Path, PurePosixPath, PureWindowsPath

from servoscope.errors import DataSetError


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
    if not any(folder.iterdir()):
        raise DataSetError(f"{folder} is empty; it must hold {' and '.join(wanted)}.")
    for name in wanted:
        if not (folder / name).is_file():
            raise DataSetError(f"{folder / name} is missing; write it or name another folder.")


def read_text(path: Path) -> str:
    """The UTF-8 text of a file, with or without a byte order mark.

    Raises
    ------
    DataSetError
        If the file cannot be read or is not text.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise DataSetError(f"{path} cannot be read ({error.strerror}).") from error
    except UnicodeDecodeError as error:
        raise DataSetError(f"{path} is not UTF-8 ({error.reason}); save it as such.") from error
    if "\0" in text:
        raise DataSetError(f"{path} is not text (it holds NUL bytes); save it as UTF-8.")
    return text


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
    numbers = []
    for text, column in zip(texts, columns, strict=True):
        try:
            number = float(text)
        except ValueError:
            number = None
        if number is None or not math.isfinite(number):
            raise DataSetError(
                f"{where}: {column} must be a finite number, got {text.strip()!r}; mend the line, "
                "or leave it out with --skip-bad."
            )
        numbers.append(number)
    return numbers


def parse_pose(texts: Sequence[str], columns: Sequence[str], where: str) -> list[float]:
    """Seven numbers of a pose, translation and then quaternion.

    Raises
    ------
    DataSetError
        If one is not a finite number, or the quaternion has zero length.
    """
    numbers = parse_numbers(texts, columns, where)
    if math.hypot(*numbers[3:]) < 1e-6:
        raise DataSetError(
            f"{where}: the quaternion {numbers[3:]} has zero length; mend the line, or leave it "
            "out with --skip-bad."
        )
    return numbers


def relative_name(text: str, where: str) -> str:
    r"""Name of a file relative to the folder, with ``/`` between its parts.

    Raises
    ------
    DataSetError
        If it is empty, or leads out of the folder.

    Examples
    --------
    >>> relative_name(r".\left\0001.png", "poses.csv, line 2")
    'left/0001.png'
    """
    name = posixpath.normpath(text.strip().replace("\\", "/"))
    if name == ".":
        raise DataSetError(f"{where}: the name of the image is empty.")
    absolute = PurePosixPath(name).is_absolute() or PureWindowsPath(name).drive
    if absolute or name.split("/")[0] == "..":
        raise DataSetError(
            f"{where}: {text.strip()!r} leads out of the folder; name images relative to it."
        )
    return name
