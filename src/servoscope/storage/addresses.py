"""Folders at addresses of other file systems, such as ``s3://bucket/set``, read by fsspec.

Small files are copied first, chunks of a stack where its items are asked for, both into a scratch
folder; they are checked there as those of a local folder are, and removed. Keys to a file system
are those that its own library finds, in its environment variables and files.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from urllib.request import url2pathname

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import DataSetError
from servoscope.storage.folders import scratch_folder
from servoscope.storage.stacks import (
    BLOCK_BYTES,
    Stack,
    check_all_there,
    check_chunk,
    check_unpacked,
    chunk_name,
    most_packed,
)
from servoscope.wording import one_line

_LOCAL = ("file", "local")
_REFUSED = ("reference", "dask")  # they follow what an index says, or run at workers of theirs
_EXTRAS = {"s3": "servoscope[cloud]", "s3a": "servoscope[cloud]", "gs": "gcsfs", "gcs": "gcsfs"}


def place_of(folder: str | os.PathLike[str]) -> Path | str:
    """Where a folder is: a path, or the address of one in another file system.

    Examples
    --------
    >>> place_of("S3://bucket/set/"), place_of("file:///data/set").as_posix()
    ('s3://bucket/set', '/data/set')
    """
    text = os.fspath(folder)
    scheme = _scheme(text)
    if scheme in _LOCAL:
        host, slash, path = text.split("://", 1)[1].partition("/")
        if host not in ("", "localhost") or not slash:
            raise DataSetError(
                f"{text} names a folder of another machine, or none; write "
                f"{scheme}:///folder, or a path."
            )
        return Path(url2pathname(f"/{path}"))
    return Path(text) if scheme is None else scheme + text[len(scheme) :].rstrip("/")


def absolute(folder: str | os.PathLike[str]) -> str:
    """An absolute path, or the address, of a folder."""
    place = place_of(folder)
    return place if isinstance(place, str) else str(place.resolve())


def _scheme(text: str) -> str | None:
    found = re.match(r"([A-Za-z][A-Za-z0-9+.:-]*)://", text)
    return None if found is None else found[1].lower()


def _file_system(address: str) -> tuple[Any, str]:
    """The file system of an address, and the path in it."""
    scheme = _scheme(address)
    if "::" in address or scheme in _REFUSED:
        raise DataSetError(f"{address} is an address that is not followed; copy the folder.")
    try:
        from fsspec.core import url_to_fs

        file_system, root = url_to_fs(address)
    except ImportError as error:
        package = f': pip install "{_EXTRAS[scheme]}"' if scheme in _EXTRAS else ""
        raise DataSetError(
            f"{address} cannot be read ({one_line(error)}); install what reads it{package}."
        ) from error
    except Exception as error:  # file systems raise of every kind
        raise DataSetError(
            f"{address} cannot be read ({one_line(error)}); see that it is the address of a folder."
        ) from error
    return file_system, str(root).rstrip("/")


@contextmanager
def fetched(address: str, largest: Mapping[str, int]) -> Iterator[Path]:
    """A scratch folder with some files of the folder at an address, those of them that are there.

    Parameters
    ----------
    address : str
    largest : dict
        Most bytes of each file, by its path in the folder.

    Raises
    ------
    DataSetError
        If there is nothing at the address, it cannot be read, or a file is larger. One that the
        block raises names the address in place of the scratch folder.
    """
    file_system, root = _file_system(address)
    with _failures_of(address):
        file_system.invalidate_cache()
        sizes = {name: _size(file_system, f"{root}/{name}") for name in largest}
    there = {name: size for name, size in sizes.items() if size is not None}
    if not there:
        raise DataSetError(f"{address} is not a data set folder: it has no {next(iter(largest))}.")
    for name, size in there.items():
        if size > largest[name]:
            raise DataSetError(
                f"{address}/{name} has more than {largest[name]} bytes ({size}); make it smaller."
            )
    with TemporaryDirectory(dir=scratch_folder()) as scratch, _named(scratch, address):
        _copy(address, {name: largest[name] for name in there}, Path(scratch))
        yield Path(scratch)


def _size(file_system: Any, path: str) -> int | None:
    """The bytes of a file; None if there is none."""
    try:
        info = file_system.info(path)
    except FileNotFoundError:
        return None
    return int(info["size"]) if info["type"] == "file" else None


def _copy(address: str, largest: Mapping[str, int], folder: Path) -> None:
    """Copy files of a folder at an address, several at once, none of more bytes than it may have;
    what is larger is cut, and shows by its size.
    """
    file_system, root = _file_system(address)
    paths, ends = [f"{root}/{name}" for name in largest], [most + 1 for most in largest.values()]
    with _failures_of(address):
        contents = file_system.cat_ranges(paths, 0, ends, on_error="return")
    for name, content in zip(largest, contents, strict=True):
        if isinstance(content, Exception):
            raise DataSetError(
                f"{address}/{name} cannot be read ({one_line(content)}); restore it."
            ) from content
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)


class DistantStack(Stack):
    """A `Stack` at an address, of which the chunks that are asked for are fetched.

    Another process that gets it fetches its own.

    Parameters
    ----------
    address : str
        Of the stack.
    path : Path
        A folder with its ``zarr.json``, which is read now.
    shape, dtype
        As of `Stack`.

    Raises
    ------
    DataSetError
        As by `Stack`; what is wrong with a chunk itself is found where it is read.
    """

    def __init__(self, address: str, path: Path, shape: tuple[int, ...], dtype: str) -> None:
        self._describe(path, shape, dtype)
        self._n_axes = len(shape)
        self.address, self._description = address, (path / "zarr.json").read_bytes()
        file_system, root = _file_system(address)
        with _failures_of(address):
            there = file_system.find(f"{root}/c", detail=True)
        if any(info.get("size") is None for info in there.values()):
            raise DataSetError(
                f"{address} cannot be read (its server does not list the sizes of files); copy the "
                "data set to a folder."
            )
        sizes = {str(name)[len(root) + 1 :]: int(info["size"]) for name, info in there.items()}
        names = [chunk_name(i, len(shape)) for i in range(self.n_chunks)]
        check_all_there(address, [name in sizes for name in names])
        packed = sum(sizes[name] for name in names)
        check_unpacked(address, packed, self.n_chunks * self.chunk_bytes)

    def _read(self, items: NDArray[np.intp]) -> NDArray[Any]:
        found = np.empty((len(items), *self._item), self.dtype)
        chunk_of = items // self.per_chunk
        chunks, at_once = np.unique(chunk_of), max(1, BLOCK_BYTES // self.chunk_bytes)
        for start in range(0, len(chunks), at_once):
            some = chunks[start : start + at_once]
            own = (chunk_of >= some[0]) & (chunk_of <= some[-1])
            with self._fetched(some) as path:
                found[own] = self._read_from(path, items[own])
        return found

    @contextmanager
    def _fetched(self, chunks: Sequence[int] | NDArray[np.integer]) -> Iterator[Path]:
        """A stack in a scratch folder that has some of the chunks, which are checked."""
        names = [chunk_name(int(i), self._n_axes) for i in chunks]
        with TemporaryDirectory(dir=scratch_folder()) as scratch, _named(scratch, self.address):
            path = Path(scratch)
            (path / "zarr.json").write_bytes(self._description)
            _copy(self.address, dict.fromkeys(names, most_packed(self.chunk_bytes)), path)
            for name in names:
                check_chunk(path, path / name, self.chunk_bytes)
            yield path


@contextmanager
def _named(scratch: str, address: str) -> Iterator[None]:
    """Let errors name an address where they would name the scratch folder."""
    try:
        yield
    except DataSetError as error:
        raise DataSetError(str(error).replace(scratch, address)) from error


@contextmanager
def _failures_of(address: str) -> Iterator[None]:
    """Say in a line that a file system fails, which it does in ways of its own."""
    try:
        yield
    except Exception as error:
        raise DataSetError(
            f"{address} cannot be read ({one_line(error)}); see that it is there, and that this "
            "machine may read it."
        ) from error
