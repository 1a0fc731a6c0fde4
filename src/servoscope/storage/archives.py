"""Archives of arrays, ``.npz``, that come from anybody; those of models agree with a table.

They are written uncompressed, so that no array unpacks to more than the file has bytes.
"""

from __future__ import annotations

import hashlib
import io
import math
import os
import re
import struct
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from reprlib import repr as brief
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import InvalidInputError
from servoscope.storage.reading import check_regular, open_without_waiting, words

MOST_MEMBERS = 10_000
"""Most arrays in an archive."""

MOST_LISTED = 1024
"""Most bytes that the list at the end of an archive has for each member, on the average."""

_END, _END64, _END_SIZE, _END64_SIZE = b"PK\5\6", b"PK\6\7", 22, 20


def read_arrays(
    path: Path, names: Iterable[str] | None, error: type[Exception]
) -> dict[str, NDArray[Any]]:
    """The named arrays of an ``.npz`` that was written uncompressed; all if there are no names.

    `error` is raised as by `read_bytes`, or if the archive is damaged, lacks an array, or holds one
    that is compressed, of objects, or larger than the file.
    """
    check_regular(path, error)
    try:
        with open_archive(path) as archive:
            if names is None:
                names = [name.removesuffix(".npy") for name in archive.namelist()]
            return {name: read_member(archive, f"{name}.npy") for name in names}
    except Exception as reason:  # zipfile and numpy raise of every kind on damaged files
        raise error(f"{path} cannot be read ({words(reason)}).") from reason


@contextmanager
def open_archive(path: Path) -> Iterator[zipfile.ZipFile]:
    """A zip archive of at most `MOST_MEMBERS` members, which are counted before they are listed.

    One that ends with a comment or a record of larger numbers, which no archive of arrays does, is
    a ValueError.
    """
    with open(path, "rb", opener=open_without_waiting) as file:
        _check_end(file)
        with zipfile.ZipFile(file) as archive:
            yield archive


def _check_end(file: BinaryIO) -> None:
    """Check how many members an archive declares, and that their list is no longer than theirs.

    zipfile reads the list by its length, whatever number is declared.
    """
    file.seek(max(0, os.fstat(file.fileno()).st_size - _END_SIZE - _END64_SIZE))
    before, end = (last := file.read())[:-_END_SIZE], last[-_END_SIZE:]
    if len(end) != _END_SIZE or end[:4] != _END or end[-2:] != b"\0\0" or before[:4] == _END64:
        raise ValueError("it is no archive of arrays, or its end is lost")
    n_members, n_bytes = struct.unpack("<HI", end[10:16])
    if n_members > MOST_MEMBERS:
        raise ValueError(f"it has {n_members} members, more than {MOST_MEMBERS}")
    if n_bytes > MOST_LISTED * n_members:
        raise ValueError(f"it lists {n_members} members in {n_bytes} bytes")


def read_member(archive: zipfile.ZipFile, name: str) -> NDArray[Any]:
    """One array of an archive, stored as it is and as long as it declares.

    Raises
    ------
    ValueError, KeyError, zipfile.BadZipFile
        If there is none of that name, or it is not as it declares.
    """
    member, label = archive.getinfo(name), brief(name.removesuffix(".npy"))
    if member.compress_type != zipfile.ZIP_STORED or member.file_size != member.compress_size:
        raise ValueError(f"{label} is compressed, which no array is")
    content = io.BytesIO(archive.read(member))
    version = np.lib.format.read_magic(content)
    read_header = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }.get(version)
    if read_header is None:
        raise ValueError(f"{label} is of another version of .npy")
    shape, fortran_order, dtype = read_header(content)
    n_bytes = math.prod(shape) * dtype.itemsize
    if dtype.hasobject or n_bytes != member.file_size - content.tell():
        raise ValueError(f"{label} is not as long as it declares, or not of numbers")
    array = np.frombuffer(content.getvalue(), dtype, math.prod(shape), content.tell())
    return array.reshape(shape, order="F" if fortran_order else "C").copy()


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
    """What a table says of one array:

    its type of `DTYPES`, its shape, and the SHA-256 of its numbers in C order.
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

    A model cannot hold arrays whose names are not of letters, digits and ``_ . / -``, that are not
    numbers or not finite, or too large.
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


def read_table(table: dict[str, Any]) -> dict[str, Entry]:
    """The entries of a table of plain values; raises ValueError if it is none."""
    entries = {name: _read_entry(name, values) for name, values in table.items()}
    if sum(entry.n_bytes for entry in entries.values()) > LARGEST:
        raise ValueError(f"its arrays would have more than {LARGEST} bytes")
    return entries


def read_checked_arrays(path: Path, entries: Mapping[str, Entry]) -> Arrays:
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
        raise ValueError(f"its table lacks dtype, shape and sha256 of {brief(name)}")
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
