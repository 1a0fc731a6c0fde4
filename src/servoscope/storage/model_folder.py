"""The folder of a trained model: ``model.json`` and ``arrays.npz``, whatever the model is.

``model.json`` holds the version, who wrote it, the header, a table of the arrays with check sums,
and a check sum of its own. Folders may come from anybody: nothing in them is run, and nothing is
believed that does not agree with the rest.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import stat
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from reprlib import repr as brief
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from servoscope import __version__
from servoscope.errors import FolderExistsError, InvalidInputError, ModelError
from servoscope.storage.archives import (
    Arrays,
    make_table,
    read_checked_arrays,
    read_table,
)
from servoscope.storage.folders import to_json, write_arrays, write_text
from servoscope.storage.reading import parse_json, read_bytes
from servoscope.wording import one_line

VERSION = 1
FORMAT = "servoscope model"
MODEL, ARRAYS = "model.json", "arrays.npz"

LARGEST_JSON = 4 * 2**20
"""Most bytes that ``model.json`` may have."""

Folder = str | PathLike[str]


def write_model(
    folder: Folder,
    header: Mapping[str, Any],
    arrays: Mapping[str, NDArray[Any]],
    *,
    force: bool = False,
) -> None:
    """Write a model, whole or not at all.

    Parameters
    ----------
    folder : path
        A new or an empty folder.
    header : dict
        Plain JSON values, or numpy's, which are read as plain ones.
    arrays : dict of ndarray
        Finite floating-point numbers, integers or booleans. They are read as the same type.
    force : bool
        Replace a model that is there. Interrupted at any moment, the old one or the new one is
        what `read_model` reads.

    Raises
    ------
    FolderExistsError
        If the folder holds a model and `force` is not set, or anything else.
    InvalidInputError
        If the header or the arrays cannot be held.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_model(folder, {"image_size": 64}, {"weights": np.ones((2, 3), np.float32)})
    ...     header, arrays = read_model(folder)
    >>> header, arrays["weights"].dtype, arrays["weights"].shape
    ({'image_size': 64}, dtype('float32'), (2, 3))
    """
    path = Path(os.path.realpath(folder))
    check_free(path, force=force)
    arrays = {name: np.asarray(array) for name, array in arrays.items()}
    text = _to_text(header, make_table(arrays))
    part = path.parent / f".{path.name}.servoscope-part"
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    try:
        write_arrays(part / ARRAYS, arrays)
        write_text(part / MODEL, text)
        if path.exists():
            path.rename(_aside(path))
        part.rename(path)
    finally:
        _settle(path)
        shutil.rmtree(part, ignore_errors=True)


def read_model(folder: Folder) -> tuple[dict[str, Any], Arrays]:
    """The header and the arrays of a model, exactly as they were written.

    Raises
    ------
    ModelError
        If it is missing, unfinished, damaged, of a newer version, or not what a model may be.
    """
    path, values = _open(Path(folder))
    try:
        _check_regular(path / ARRAYS)
        return values["header"], read_checked_arrays(path / ARRAYS, read_table(values["arrays"]))
    except Exception as error:  # zipfile and numpy raise of every kind on damaged files
        _refuse(path / ARRAYS, error)


def read_version(folder: Folder) -> tuple[int, str]:
    """The version of a model's form, and that of the servoscope that wrote it.

    Raises
    ------
    ModelError
        If ``model.json`` is missing, damaged or of a newer version.
    """
    _, values = _open(Path(folder))
    return values["version"], values["servoscope"]


def is_model(folder: Folder) -> bool:
    """Whether the folder holds a model, of whatever version, whole or damaged."""
    path = Path(folder)
    return (path / MODEL).exists() or ((_aside(path) / MODEL).exists() and not path.exists())


def check_free(folder: Folder, *, force: bool = False) -> None:
    """Raise FolderExistsError if a model cannot be written to the folder.

    With `force` it may replace a model, but nothing else, nor anything that lies beside one.
    """
    path = Path(folder)
    _settle(path)
    if not path.exists():
        return
    if not path.is_dir():
        raise FolderExistsError(f"{path} is a file; name a folder.")
    held = {part.name for part in path.iterdir()}
    if others := sorted(held - {MODEL, ARRAYS}):
        raise FolderExistsError(
            f"{path} holds {brief(others[0])}, which is no part of a model; name another folder."
        )
    if held and not _is_ours(path / MODEL):
        raise FolderExistsError(
            f"{path} holds no whole model; remove it yourself, or name another folder."
        )
    if held and not force:
        raise FolderExistsError(
            f"{path} holds a model already; name another folder, or replace it with --force."
        )


def _to_text(header: Mapping[str, Any], table: dict[str, dict[str, Any]]) -> str:
    try:
        plain = json.loads(to_json(dict(header)))
    except (TypeError, ValueError, RecursionError) as error:
        raise InvalidInputError(f"The header of a model must be JSON ({error}).") from error
    values = {
        "format": FORMAT,
        "version": VERSION,
        "servoscope": __version__,
        "header": plain,
        "arrays": json.loads(to_json(table)),
    }
    text = to_json({**values, "sha256": _digest(values)}) + "\n"
    if len(text) > LARGEST_JSON:
        raise InvalidInputError(
            f"{MODEL} may have {LARGEST_JSON} bytes, got {len(text)}; put numbers into arrays."
        )
    return text


def _digest(values: dict[str, Any]) -> str:
    text = json.dumps(values, sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def _open(path: Path) -> tuple[Path, dict[str, Any]]:
    """Where the model is, and what its ``model.json`` holds, known to be as it was written."""
    try:
        path = _find(path)
        values = _read_json(path / MODEL)
        _check_version(path, values)
        _check_content(values)
    except ModelError:
        raise
    except Exception as error:  # a hostile file is wrong in ways of its own
        _refuse(path / MODEL, error)
    return path, values


def _find(path: Path) -> Path:
    """The folder, or where it was set aside when a replacement was killed."""
    if not path.exists() and _aside(path).is_dir():
        return _aside(path)
    if not path.exists():
        raise ModelError(f"{path} does not exist; name the folder of a trained model.")
    if not path.is_dir():
        raise ModelError(f"{path} is a file; name the folder of a trained model.")
    if not (path / MODEL).is_file() and not (path / MODEL).is_symlink():
        raise ModelError(
            f"{path} is not a model, or an unfinished one: it has no {MODEL}; name a folder that "
            "train wrote."
        )
    return path


def _settle(path: Path) -> None:
    """End a replacement that was stopped between its two renamings, or after them."""
    if not path.exists() and _aside(path).is_dir():
        _aside(path).rename(path)
    shutil.rmtree(_aside(path), ignore_errors=True)


def _aside(path: Path) -> Path:
    path = Path(os.path.realpath(path))
    return path.parent / f".{path.name}.servoscope-old"


def _is_ours(path: Path) -> bool:
    try:
        return _read_json(path).get("format") == FORMAT
    except (OSError, ValueError):
        return False


def _read_json(path: Path) -> dict[str, Any]:
    """A JSON object; raises OSError or ValueError if there is none."""
    _check_regular(path)
    values = parse_json(read_bytes(path, ValueError, LARGEST_JSON))
    if not isinstance(values, dict):
        raise ValueError(f"it must hold a JSON object, got a {type(values).__name__}")
    return values


def _check_regular(path: Path) -> None:
    """A link may lead anywhere, and reading a pipe may never end."""
    if not stat.S_ISREG(path.lstat().st_mode):
        raise ValueError("it is a link or no file; copy the file itself there")


def _check_version(path: Path, values: dict[str, Any]) -> None:
    if values.get("format") != FORMAT:
        raise ValueError("it is not a model of servoscope")
    version = values.get("version")
    if type(version) is not int or version < 1:
        raise ValueError(f"its version is {brief(version)}")
    if version > VERSION:
        raise ModelError(
            f"{path} is of version {brief(version)}, written by servoscope "
            f"{brief(values.get('servoscope'))}; servoscope {__version__} reads version {VERSION}: "
            "update it, or train the model again."
        )


def _check_content(values: dict[str, Any]) -> None:
    signed = {key: value for key, value in values.items() if key != "sha256"}
    if values.get("sha256") != _digest(signed):
        raise ValueError("it has changed since it was written")
    for key, kind in (("servoscope", str), ("header", dict), ("arrays", dict)):
        if not isinstance(values.get(key), kind):
            raise ValueError(f"its {key} is {brief(values.get(key))}")


def _refuse(path: Path, error: Exception) -> NoReturn:
    raise ModelError(
        f"{path} cannot be read ({one_line(error)}); copy the model anew, or train it again."
    ) from error
