"""The arrays of a model in one ``.npz``, and the table that they are checked against.

Nothing is taken from the file before it agrees with the table. Arrays are stored uncompressed, so
that nothing unpacks to more than the file has bytes.
"""

from __future__ import annotations

import hashlib
import math
import re
import zipfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from reprlib import repr as brief
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import InvalidInputError
from servoscope.files import write_atomically
from servoscope.storage.archives import open_archive, read_member

LARGEST = 2 * 2**30
"""Most bytes that the arrays of a model may have together."""

DTYPES = ("|b1", "|i1", "|u1", *(f"<{kind}{n}" for n in (2, 4, 8) for kind in "iuf"))
"""The types of numbers that a model may hold."""

MOST_AXES = 8
_NAME = re.compile(r"\w+([./-]\w+)*", re.ASCII)
_OVERHEAD, _OVERHEAD_PER_ARRAY = 1024, 1024  # what a zip adds to its members, at most

Arrays = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class Entry:
    """What a table says of one array.

    Parameters
    ----------
    dtype : str
        One of `DTYPES`.
    shape : tuple of int
    sha256 : str
        Of the numbers in C order, in hexadecimal digits.
    """

    dtype: str
    shape: tuple[int, ...]
    sha256: str

    @property
    def n_bytes(self) -> int:
        """Bytes of the numbers."""
        return math.prod(self.shape) * np.dtype(self.dtype).itemsize


def make_table(arrays: Mapping[str, NDArray[Any]]) -> dict[str, dict[str, Any]]:
    """The table of some arrays, as plain values.

    Raises
    ------
    InvalidInputError
        If a model cannot hold them: a name is not of letters, digits and ``_ . / -``, they are not
        numbers or not finite, or they are too large.
    """
    if (total := sum(array.nbytes for array in arrays.values())) > LARGEST:
        raise InvalidInputError(f"A model may hold {LARGEST} bytes in its arrays, got {total}.")
    try:
        for name, array in arrays.items():
            _check_kind(name, array.dtype.str, array.shape)
            _check_finite(name, array)
    except ValueError as error:
        raise InvalidInputError(f"A model cannot hold these arrays: {error}.") from error
    return {
        name: asdict(Entry(array.dtype.str, array.shape, _digest(array)))
        for name, array in arrays.items()
    }


def write_arrays(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write the arrays to a file, whole or not at all; equal arrays give equal bytes."""

    def write(file: Any) -> None:
        with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
            for name, array in arrays.items():
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    plain = np.asarray(array, order="C")
                    np.lib.format.write_array(member, plain, allow_pickle=False)

    write_atomically(path, write)


def read_table(table: dict[str, Any]) -> dict[str, Entry]:
    """The entries of a table of plain values; raises ValueError if it is none."""
    entries = {name: _read_entry(name, values) for name, values in table.items()}
    if sum(entry.n_bytes for entry in entries.values()) > LARGEST:
        raise ValueError(f"its arrays would have more than {LARGEST} bytes")
    return entries


def read_arrays(path: Path, entries: Mapping[str, Entry]) -> Arrays:
    """The arrays in a file; raises, whatever the reason is, unless they are those of the table."""
    content = sum(entry.n_bytes for entry in entries.values())
    names = sum(2 * len(name) for name in entries)
    most = content + names + _OVERHEAD + _OVERHEAD_PER_ARRAY * len(entries)
    if not content <= path.stat().st_size <= most:
        raise ValueError(
            f"it has {path.stat().st_size} bytes, where {content} of arrays are expected"
        )
    with open_archive(path) as archive:
        members = {member.filename: member for member in archive.infolist()}
        _check_names(entries, [member.filename for member in archive.infolist()])
        return {
            name: _read_array(archive, members[f"{name}.npy"], name, entry)
            for name, entry in entries.items()
        }


def _read_entry(name: str, values: Any) -> Entry:
    if not isinstance(values, dict) or values.keys() != {"dtype", "shape", "sha256"}:
        raise ValueError(f"its table tells not dtype, shape and sha256 of {brief(name)}")
    shape = values["shape"]
    if not isinstance(shape, list) or any(type(n) is not int or n < 0 for n in shape):
        raise ValueError(f"the shape of {brief(name)} is {brief(shape)}")
    _check_kind(name, values["dtype"], tuple(shape))
    return Entry(values["dtype"], tuple(shape), values["sha256"])


def _check_kind(name: str, dtype: str, shape: tuple[int, ...]) -> None:
    if not _NAME.fullmatch(name) or len(name) > 200:
        raise ValueError(f"an array cannot be called {brief(name)}")
    if dtype not in DTYPES:
        raise ValueError(f"{brief(name)} is of type {brief(dtype)}, which is not of numbers")
    if len(shape) > MOST_AXES:
        raise ValueError(f"{brief(name)} has {len(shape)} axes, more than {MOST_AXES}")


def _check_names(entries: Mapping[str, Entry], members: list[str]) -> None:
    expected = {f"{name}.npy" for name in entries}
    if missing := sorted(expected.difference(members)):
        raise ValueError(f"it lacks {brief(missing[0])}")
    if extra := sorted(set(members) - expected):
        raise ValueError(f"it holds {brief(extra[0])}, which is not in the table")
    if len(members) > len(expected):
        raise ValueError("it holds an array twice")


def _read_array(
    archive: zipfile.ZipFile, member: zipfile.ZipInfo, name: str, entry: Entry
) -> NDArray[Any]:
    if not 0 < member.file_size - entry.n_bytes <= _OVERHEAD_PER_ARRAY:
        raise ValueError(f"{brief(name)} has {member.file_size} bytes, not {entry.n_bytes}")
    array = read_member(archive, member.filename)
    if (array.shape, array.dtype) != (entry.shape, np.dtype(entry.dtype)):
        raise ValueError(
            f"{brief(name)} is {array.dtype} of shape {brief(array.shape)}, not {entry.dtype} of "
            f"shape {brief(entry.shape)}"
        )
    if _digest(array) != entry.sha256:
        raise ValueError(f"the bytes of {brief(name)} have changed since they were written")
    _check_finite(name, array)
    return array


def _check_finite(name: str, array: NDArray[Any]) -> None:
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        raise ValueError(f"{brief(name)} holds NaN or infinite numbers")


def _digest(array: NDArray[Any]) -> str:
    """Hash of the numbers in C order."""
    numbers = np.asarray(array, order="C").reshape(-1).view(np.uint8)
    return hashlib.sha256(numbers.data).hexdigest()
