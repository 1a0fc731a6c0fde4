"""Stacks of arrays on disk, chunked by their first axis: zarr with one pair of codecs.

A stack may come from anybody. Its ``zarr.json`` must describe a stack as `create_stack` makes it,
and each chunk must declare the size that it has, before anything is unpacked.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from copy import copy
from itertools import islice
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from typing import Any
from weakref import finalize

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import DataSetError
from servoscope.storage.folders import scratch_folder
from servoscope.storage.reading import check_regular, read_json
from servoscope.wording import one_line

PER_CHUNK = 25
"""Most items of a chunk."""

LARGEST_CHUNK = 2**31 - 2**20
"""Most bytes of a chunk: Blosc takes no more."""

LARGEST_STACK = 2**36
"""Most bytes of a stack."""

LARGEST_CONSTANT = 2**28
"""Most bytes of a stack that unpacks to more than a hundred times its files: no pictures do."""

_BLOSC_HEAD, _CRC, _MOST_PACKED = 16, 4, 100
_CODECS = ("bytes", "blosc", "crc32c")
_KNOWN = {
    "zarr_format": 3,
    "node_type": "array",
    "chunk_key_encoding": {"name": "default", "configuration": {"separator": "/"}},
    "fill_value": 0,
    "storage_transformers": [],
}


def create_stack(path: Path, shape: tuple[int, ...], dtype: str) -> None:
    """Make an empty stack of `shape[0]` items."""
    import zarr
    from zarr.codecs import BloscCodec, Crc32cCodec

    zarr.create_array(
        path,
        shape=shape,
        chunks=(min(PER_CHUNK, shape[0]), *shape[1:]),
        dtype=dtype,
        # Blosc does not notice that its input is too short; the check sum does.
        compressors=(BloscCodec(cname="lz4", clevel=3, shuffle="noshuffle"), Crc32cCodec()),
    )


def write_stack(path: Path, start: int, items: NDArray[Any]) -> None:
    """Write items at positions ``start, start + 1, ...`` of a stack."""
    import zarr

    read_stack_shape(path, items.ndim, items.dtype.name)
    # Items of zeros are written too, so that a chunk that is not there is known to be lost.
    with zarr.config.set({"array.write_empty_chunks": True}):
        zarr.open_array(path, mode="r+", zarr_format=3)[start : start + len(items)] = items


def read_stack_shape(path: Path, n_axes: int, dtype: str) -> tuple[int, ...]:
    """The shape that a stack declares.

    Raises
    ------
    DataSetError
        If it is not described as `create_stack` does, or larger than `LARGEST_STACK`.
    """
    return _read_description(path, n_axes, dtype)[0]


class Stack:
    """Items of a stack on disk, read where they are asked for: at most a block of them at a time.

    ``stack[index]`` is an array of some items, `take` chooses items without reading them, and
    ``np.asarray(stack)`` reads all. It has the shape and type of the array that it stands for.

    Parameters
    ----------
    path : Path
    shape : tuple of int
        That the stack must have.
    dtype : str

    Raises
    ------
    DataSetError
        If it is missing, of another shape, type or codec, lost a chunk or has one that declares
        another size. Items that turn out to be damaged are one where they are read.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> items = np.arange(24, dtype=np.uint8).reshape(6, 2, 2)
    >>> with TemporaryDirectory() as folder:
    ...     create_stack(Path(folder) / "items", items.shape, "uint8")
    ...     write_stack(Path(folder) / "items", 0, items)
    ...     stack = Stack(Path(folder) / "items", items.shape, "uint8")
    ...     len(stack.take(np.array([5, 0]))), stack[1:3].tolist() == items[1:3].tolist()
    (2, True)
    """

    def __init__(self, path: Path, shape: tuple[int, ...], dtype: str) -> None:
        self._describe(path, shape, dtype)
        chunks = [path / chunk_name(i, len(shape)) for i in range(self.n_chunks)]
        is_there = [chunk.exists() for chunk in chunks]
        check_all_there(path, is_there)
        packed = sum(check_chunk(path, chunk, self.chunk_bytes) for chunk in chunks)
        check_unpacked(path, packed, self.n_chunks * self.chunk_bytes)
        self.path = path
        self.folder: _Temporary | None = None

    def _describe(self, path: Path, shape: tuple[int, ...], dtype: str) -> None:
        """Take over what ``zarr.json`` says, if it is what is wanted."""
        declared, self.per_chunk = _read_description(path, len(shape), dtype)
        if declared != shape:
            raise _refusal(path, f"it holds {dtype} of shape {declared}, not {shape}")
        self.dtype = np.dtype(dtype)
        self.n_chunks = -(-shape[0] // self.per_chunk)
        self.chunk_bytes = self.per_chunk * math.prod(shape[1:]) * self.dtype.itemsize
        self._item, self._items = shape[1:], np.arange(shape[0])

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of the array that it stands for."""
        return len(self), *self._item

    @property
    def ndim(self) -> int:
        """The number of axes."""
        return 1 + len(self._item)

    @property
    def nbytes(self) -> int:
        """The bytes of all items in memory."""
        return math.prod(self.shape) * self.dtype.itemsize

    def __len__(self) -> int:
        return len(self._items)

    def flat(self) -> Stack:
        """The same with each item in one row."""
        flat = copy(self)
        flat._item = (math.prod(self._item),)
        return flat

    def take(self, items: NDArray[np.integer]) -> Stack:
        """Some of the items, in their order, none of which is read."""
        taken = copy(self)
        taken._items = self._items[items]
        return taken

    def __getitem__(self, index: Any) -> Any:
        """The items of an index along the first axis, as an array."""
        items = self._items[index]
        if not items.ndim:
            return self._read(items[None])[0]
        return self._read(items)

    def __iter__(self) -> Iterator[NDArray[Any]]:
        for block in blocks_of(self):
            yield from block

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        if copy is False:
            raise ValueError("A stack on disk cannot be an array without being read.")
        return np.asarray(self._read(self._items), dtype=dtype)

    def _read(self, items: NDArray[np.intp]) -> NDArray[Any]:
        return self._read_from(self.path, items)

    def _read_from(self, path: Path, items: NDArray[np.intp]) -> NDArray[Any]:
        import zarr

        if not items.size:
            return np.empty((0, *self._item), self.dtype)
        wanted, place = np.unique(items, return_inverse=True)
        try:
            stack = zarr.open_array(path, mode="r", zarr_format=3)
            if wanted[-1] - wanted[0] == len(wanted) - 1:
                found = np.asarray(stack[int(wanted[0]) : int(wanted[-1]) + 1])
            else:
                found = np.asarray(stack.oindex[wanted])
        except Exception as error:  # zarr and its codecs raise of every kind on damaged files
            raise _refusal(path, error) from error
        found = found if np.array_equal(wanted, items) else found[place]
        return found.reshape(len(found), *self._item)


def some_of(items: NDArray[Any], chosen: NDArray[Any]) -> NDArray[Any]:
    """Some items of an array or of a stack, chosen by their numbers or by a mask.

    Those of a stack are not read.
    """
    return items.take(chosen) if isinstance(items, Stack) else items[chosen]


def read_stack(path: Path, shape: tuple[int, ...], dtype: str) -> NDArray[Any]:
    """All items of a stack at once; see `Stack`."""
    items: NDArray[Any] = Stack(path, shape, dtype)[:]
    return items


def gathered(
    items: Iterable[NDArray[Any]], shape: tuple[int, ...], dtype: str, in_memory: float
) -> NDArray[Any]:
    """Items that come one after another as an array, or as a `Stack` where they are too many.

    Parameters
    ----------
    items : iterable of shape[0] ndarray
    shape : tuple of int
        Of all of them.
    dtype : str
    in_memory : float
        Where they take more bytes than that, they are written to a temporary folder, which goes
        with the stack.
    """
    if math.prod(shape) * np.dtype(dtype).itemsize <= in_memory:
        array = np.empty(shape, dtype)
        for i, item in enumerate(items):
            array[i] = item
        return array
    path = Path(mkdtemp(dir=scratch_folder())) / "stack.zarr"
    create_stack(path, shape, dtype)
    start, n, left = 0, _per_block(shape, np.dtype(dtype)), iter(items)
    while block := list(islice(left, n)):
        write_stack(path, start, np.stack(block))
        start += len(block)
    stack: Any = Stack(path, shape, dtype)
    stack.folder = _Temporary(path.parent)
    return stack


class _Temporary:
    """A folder that goes when nothing refers to it any more."""

    def __init__(self, path: Path) -> None:
        self._end = finalize(self, rmtree, path, ignore_errors=True)

    def __getstate__(self) -> None:  # another process does not own it
        return None


BLOCK_BYTES = 2**24
"""Bytes of the items that are read of a stack at a time."""


def blocks_of(items: NDArray[Any] | Stack) -> Iterator[NDArray[Any]]:
    """An array, or a stack, in blocks of some items, in their order."""
    n = _per_block(items.shape, items.dtype)
    for start in range(0, len(items), n):
        yield items[start : start + n]


def _per_block(shape: tuple[int, ...], dtype: np.dtype[Any]) -> int:
    """Items of a block, in whole chunks, so that none is packed or unpacked twice."""
    n = BLOCK_BYTES // max(1, math.prod(shape[1:]) * dtype.itemsize)
    return max(PER_CHUNK, n // PER_CHUNK * PER_CHUNK)


def _read_description(path: Path, n_axes: int, dtype: str) -> tuple[tuple[int, ...], int]:
    """Shape and items per chunk of a stack, which is known to be one of ours."""
    values = read_json(path / "zarr.json", DataSetError)
    shape: Any = values.get("shape")
    if values.get("data_type") != dtype or not _are_lengths(shape) or len(shape) != n_axes:
        raise _refusal(path, f"it holds {values.get('data_type')!r} of shape {shape!r}")
    if math.prod(shape) * np.dtype(dtype).itemsize > LARGEST_STACK:
        raise _refusal(path, f"its shape {shape} takes more than {LARGEST_STACK} bytes")
    for key, known in _KNOWN.items():
        if values.get(key, known) != known:
            raise _refusal(path, f"its {key} is {values[key]!r}")
    chunk: Any = _configuration(path, values.get("chunk_grid"), "regular").get("chunk_shape")
    if not _are_lengths(chunk) or chunk[1:] != shape[1:] or chunk[0] > min(PER_CHUNK, shape[0]):
        raise _refusal(path, f"its chunks are {chunk!r}")
    if chunk[0] * math.prod(shape[1:]) * np.dtype(dtype).itemsize > LARGEST_CHUNK:
        raise _refusal(path, f"its chunks {chunk} take more than {LARGEST_CHUNK} bytes")
    codecs = values.get("codecs")
    if not isinstance(codecs, list) or len(codecs) != len(_CODECS):
        raise _refusal(path, "its codecs are not bytes, blosc and crc32c")
    for codec, name in zip(codecs, _CODECS, strict=True):
        configuration = _configuration(path, codec, name)
        if configuration.get("endian", "little") != "little":
            raise _refusal(path, "its bytes are not little-endian")
    if _configuration(path, codecs[1], "blosc").get("cname") != "lz4":
        raise _refusal(path, "it is not compressed by lz4")
    return tuple(shape), chunk[0]


def _configuration(path: Path, value: Any, name: str) -> dict[str, Any]:
    """The configuration of a part of ``zarr.json`` that has this name; empty if it has none."""
    if not isinstance(value, dict) or value.get("name") != name:
        raise _refusal(path, f"it has {value!r} where {name} was wanted")
    configuration = value.get("configuration", {})
    return configuration if isinstance(configuration, dict) else {}


def _are_lengths(values: Any) -> bool:
    return isinstance(values, list) and all(type(n) is int and 0 < n < 2**40 for n in values)


def chunk_name(i: int, n_axes: int) -> str:
    """The file of a chunk in the folder of a stack.

    Examples
    --------
    >>> chunk_name(7, 3)
    'c/7/0/0'
    """
    return "/".join(["c", str(i), *"0" * (n_axes - 1)])


def most_packed(n_bytes: int) -> int:
    """Most bytes of the file of a chunk that unpacks to `n_bytes`."""
    return n_bytes + n_bytes // 64 + 2**16


def check_chunk(path: Path, chunk: Path, n_bytes: int) -> int:
    """The bytes of a chunk, which must declare them, and `n_bytes` unpacked."""
    size = check_regular(chunk, DataSetError, most_packed(n_bytes))
    with open(chunk, "rb") as file:
        head = file.read(_BLOSC_HEAD)
    unpacked, packed = (int.from_bytes(head[i : i + 4], "little") for i in (4, 12))
    if len(head) < _BLOSC_HEAD or (unpacked, packed) != (n_bytes, size - _CRC):
        raise _refusal(
            path, f"{chunk.relative_to(path)} declares {unpacked} bytes unpacked, not {n_bytes}"
        )
    return size


def check_all_there(place: Path | str, is_there: Sequence[bool]) -> None:
    """Raise DataSetError if a chunk of a stack is missing."""
    if lost := is_there.count(False):
        raise _refusal(place, f"{lost} of {len(is_there)} chunks are missing")


def check_unpacked(place: Path | str, packed: int, unpacked: int) -> None:
    """Raise DataSetError if chunks would unpack to far more than pictures do."""
    if unpacked > max(LARGEST_CONSTANT, _MOST_PACKED * packed):
        raise _refusal(place, f"{packed} bytes of files would unpack to {unpacked}")


def _refusal(path: Path | str, reason: str | Exception) -> DataSetError:
    return DataSetError(f"{path} cannot be read ({one_line(reason)}); make the data set again.")
