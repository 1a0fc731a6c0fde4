"""Poses written as text: separators, numbers, and what makes a pose unusable."""

from __future__ import annotations

import math
import os
import posixpath
from collections.abc import Sequence
from pathlib import Path
from reprlib import repr as brief
from unicodedata import normalize

from servoscope.errors import DataSetError
from servoscope.formats.conventions import METRES
from servoscope.formats.options import Units
from servoscope.poses import FARTHEST

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
            hint = "write decimals with a point" if with_point else "mend the line"
            raise DataSetError(
                f"{where}: {column} must be a finite number, got {brief(text.strip())}; {hint}, "
                "or leave it out with --skip-bad."
            )
    return numbers


def parse_pose(
    texts: Sequence[str], columns: Sequence[str], where: str, units: Units
) -> list[float]:
    """Seven numbers of a pose, translation and then quaternion.

    Raises
    ------
    DataSetError
        If one is not a finite number, the translation is beyond `FARTHEST`, or the quaternion has
        a length of zero or above 1e6.
    """
    numbers = parse_numbers(texts, columns, where)
    largest, length = max(map(abs, numbers[:3])), max(map(abs, numbers[3:]))
    if largest * METRES[units] > FARTHEST:
        problem = f"the translation {numbers[:3]} is in no room; check --units"
    elif length < 1e-6:
        problem = f"the quaternion {numbers[3:]} has zero length; mend the line"
    elif length > 1e6:
        problem = f"the quaternion {numbers[3:]} is none; mend the line"
    else:
        return numbers
    raise DataSetError(f"{where}: {problem}, or leave it out with --skip-bad.")


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
