"""Archives of arrays, ``.npz``, that come from anybody.

They are written uncompressed, so that no array unpacks to more than the file has bytes.
"""

from __future__ import annotations

import io
import math
import os
import struct
import zipfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from reprlib import repr as brief
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

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

    Raises
    ------
    error
        As `read_bytes`, or if the archive is damaged, lacks an array, or holds one that is
        compressed, of objects, or larger than the file.
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

    Raises
    ------
    ValueError, OSError, zipfile.BadZipFile
        If it is none, or ends with a comment or a record of larger numbers, which no archive of
        arrays does.
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
