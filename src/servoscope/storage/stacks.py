"""Stacks of arrays on disk, chunked by their first axis: zarr with one pair of codecs.

A stack may come from anybody. Its ``zarr.json`` must describe a stack as `create_stack` makes it,
and each chunk must declare the size that it has, before anything is unpacked.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import DataSetError
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


def read_stack(path: Path, shape: tuple[int, ...], dtype: str) -> NDArray[Any]:
    """The items of a stack, which must have the given shape.

    One that is missing, damaged, of another shape, type or codec, that lost a chunk or has one that
    declares another size, is a `DataSetError`.
    """
    import zarr

    declared, per_chunk = _read_description(path, len(shape), dtype)
    if declared != shape:
        raise _refusal(path, f"it holds {dtype} of shape {declared}, not {shape}")
    n_chunks, inner = -(-shape[0] // per_chunk), "0" * (len(shape) - 1)
    paths = [path.joinpath("c", str(i), *inner) for i in range(n_chunks)]
    if lost := sum(not chunk.exists() for chunk in paths):
        raise _refusal(path, f"{lost} of {len(paths)} chunks are missing")
    n_bytes = per_chunk * math.prod(shape[1:]) * np.dtype(dtype).itemsize
    packed = sum(_check_chunk(path, chunk, n_bytes) for chunk in paths)
    if (unpacked := n_bytes * n_chunks) > max(LARGEST_CONSTANT, _MOST_PACKED * packed):
        raise _refusal(path, f"{packed} bytes of files would unpack to {unpacked}")
    try:
        return np.asarray(zarr.open_array(path, mode="r", zarr_format=3)[:])
    except Exception as error:  # zarr and its codecs raise of every kind on damaged files
        raise _refusal(path, error) from error


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


def _check_chunk(path: Path, chunk: Path, n_bytes: int) -> int:
    """The bytes of a chunk, which must declare them, and `n_bytes` unpacked."""
    size = check_regular(chunk, DataSetError, n_bytes + n_bytes // 64 + 2**16)
    with open(chunk, "rb") as file:
        head = file.read(_BLOSC_HEAD)
    unpacked, packed = (int.from_bytes(head[i : i + 4], "little") for i in (4, 12))
    if len(head) < _BLOSC_HEAD or (unpacked, packed) != (n_bytes, size - _CRC):
        raise _refusal(
            path, f"{chunk.relative_to(path)} declares {unpacked} bytes unpacked, not {n_bytes}"
        )
    return size


def _refusal(path: Path, reason: str | Exception) -> DataSetError:
    return DataSetError(f"{path} cannot be read ({one_line(reason)}); make the data set again.")
