import gc
import json
import os
import pickle
import shutil
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from servoscope.errors import DataSetError, InvalidInputError
from servoscope.storage import stacks
from servoscope.storage.sizes import parse_bytes
from servoscope.storage.stacks import (
    Stack,
    blocks_of,
    create_stack,
    gathered,
    read_stack,
    write_stack,
)

SHAPE = (30, 8, 9)


@pytest.fixture(scope="module")
def images():
    return np.random.default_rng(0).integers(0, 256, SHAPE, dtype=np.uint8)


@pytest.fixture(scope="module")
def written(tmp_path_factory, images):
    path = tmp_path_factory.mktemp("stack") / "images.zarr"
    create_stack(path, SHAPE, "uint8")
    write_stack(path, 0, images)
    return path


@pytest.fixture
def stack(written, tmp_path):
    return shutil.copytree(written, tmp_path / "images.zarr")


def refused(path, match, shape=SHAPE):
    with pytest.raises(DataSetError, match=match) as caught:
        read_stack(path, shape, "uint8")
    assert "\n" not in str(caught.value)


def test_a_stack_comes_back_as_it_was_written(written, images):
    np.testing.assert_array_equal(read_stack(written, SHAPE, "uint8"), images)


@given(data=st.data())
def test_a_stack_is_indexed_as_the_array_that_it_stands_for(written, images, data):
    stack, n = Stack(written, SHAPE, "uint8"), SHAPE[0]
    items = data.draw(st.lists(st.integers(-n, n - 1), max_size=12))
    some = np.array(items, dtype=int)
    part = slice(*data.draw(st.tuples(*[st.integers(-n, n)] * 2, st.sampled_from([1, 3, -1]))))
    for index in (some, part, data.draw(st.integers(-n, n - 1))):
        np.testing.assert_array_equal(stack[index], images[index])
    np.testing.assert_array_equal(np.asarray(stack.take(some)), images[some])
    np.testing.assert_array_equal(stack.take(some)[::-1], images[some][::-1])
    assert stack.take(some).shape == images[some].shape


def test_blocks_of_a_stack_are_its_items_in_order(written, images, monkeypatch):
    monkeypatch.setattr(stacks, "BLOCK_BYTES", 1)
    blocks = list(blocks_of(Stack(written, SHAPE, "uint8")))
    assert [len(block) for block in blocks] == [25, 5]
    np.testing.assert_array_equal(np.concatenate(blocks), images)


@pytest.mark.parametrize("in_memory", [0, 30 * 8 * 9 - 1, 30 * 8 * 9])
def test_items_are_gathered_in_memory_or_on_disk(images, in_memory):
    found = gathered(iter(images), SHAPE, "uint8", in_memory)
    assert isinstance(found, np.ndarray) == (in_memory >= images.nbytes)
    np.testing.assert_array_equal(np.asarray(found), images)


def test_a_temporary_folder_goes_with_the_last_stack_that_refers_to_it(images):
    stack = gathered(iter(images), SHAPE, "uint8", 0)
    folder, some, sent = stack.path.parent, stack.take(np.arange(3)), pickle.dumps(stack)
    del stack
    gc.collect()
    np.testing.assert_array_equal(np.asarray(pickle.loads(sent)), images)  # noqa: S301
    gc.collect()
    np.testing.assert_array_equal(some[:], images[:3])
    del some
    gc.collect()
    assert not folder.exists()


@pytest.mark.parametrize(("text", "n"), [("1GB", 1e9), ("500 MB", 5e8), ("2g", 2e9), ("3e6", None)])
def test_sizes_of_a_memory_are_read(text, n):
    if n is None:
        with pytest.raises(InvalidInputError, match="1MB or more"):
            parse_bytes(text)
    else:
        assert parse_bytes(text) == n


def test_zarr_reads_the_same(written, images):
    import zarr

    np.testing.assert_array_equal(zarr.open_array(written, mode="r")[:], images)


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"shape": [10**12, 8, 9]}, "takes more than"),
        ({"shape": [30, 8]}, r"shape \[30, 8\]"),
        ({"shape": [30, 8, -9]}, "shape"),
        ({"shape": [30, 8, True]}, "shape"),
        ({"shape": [31, 8, 9]}, r"shape \(31, 8, 9\), not \(30, 8, 9\)"),
        ({"data_type": "float64"}, "it holds 'float64'"),
        ({"data_type": {"name": "uint8"}}, "it holds"),
        ({"node_type": "group"}, "node_type is 'group'"),
        ({"zarr_format": 2}, "zarr_format is 2"),
        ({"fill_value": 7}, "fill_value"),
        ({"chunk_key_encoding": {"name": "v2"}}, "chunk_key_encoding"),
        ({"storage_transformers": [{"name": "x"}]}, "storage_transformers"),
        ({"chunk_grid": {"name": "rectangular"}}, "where regular was wanted"),
        ({"chunk_grid": None}, "where regular was wanted"),
        ({"codecs": []}, "codecs"),
        ({"codecs": [{"name": "bytes"}, {"name": "zstd"}, {"name": "crc32c"}]}, "where blosc was"),
        ({"codecs": [{"name": "bytes"}, {"name": "gzip"}]}, "its codecs are not"),
        ({"codecs": [{"name": "sharding_indexed"}, {"name": "blosc"}, {"name": "x"}]}, "bytes was"),
        ({"codecs": [{"name": "bytes"}, {"name": "blosc"}, {"name": "crc32c"}]}, "by lz4"),
    ],
)
def test_what_is_described_in_another_way_is_refused(stack, changes, match):
    description = json.loads((stack / "zarr.json").read_text()) | changes
    (stack / "zarr.json").write_text(json.dumps(description))
    refused(stack, match)


@pytest.mark.parametrize(
    "chunk", [[1, 1, 1], [25, 8, 8], [26, 8, 9], [0, 8, 9], [25, 8], "x", None]
)
def test_other_chunks_are_refused_and_never_listed(stack, chunk):
    description = json.loads((stack / "zarr.json").read_text())
    description["chunk_grid"]["configuration"]["chunk_shape"] = chunk
    (stack / "zarr.json").write_text(json.dumps(description))
    refused(stack, "its chunks are")


def test_a_chunk_that_would_unpack_to_more_than_its_share_is_not_unpacked(stack):
    chunk = stack / "c/1/0/0"
    content = bytearray(chunk.read_bytes())
    content[4:8] = struct.pack("<I", 2**31 - 1)
    chunk.write_bytes(content)
    refused(stack, "c/1/0/0 declares 2147483647 bytes unpacked, not 1800")


def test_a_chunk_of_flipped_bits_is_refused(stack):
    chunk = stack / "c/1/0/0"
    content = bytearray(chunk.read_bytes())
    content[40] ^= 1
    chunk.write_bytes(content)
    refused(stack, "cannot be read")


@pytest.mark.parametrize("part", ["zarr.json", "c/0/0/0"])
def test_pipes_and_folders_in_place_of_files_are_refused(stack, part):
    (stack / part).unlink()
    os.mkfifo(stack / part)
    refused(stack, "is a pipe")
    (stack / part).unlink()
    (stack / part).mkdir()
    refused(stack, "is a folder")


def test_a_large_file_in_place_of_a_chunk_is_refused(stack):
    os.truncate(stack / "c/0/0/0", 2**40)
    refused(stack, r"more than \d+ bytes")


def test_nothing_is_written_into_a_stack_of_another_kind(stack, images):
    description = json.loads((stack / "zarr.json").read_text()) | {"shape": [2**36, 8, 9]}
    (stack / "zarr.json").write_text(json.dumps(description))
    with pytest.raises(DataSetError, match="takes more than"):
        write_stack(stack, 0, images)


def test_a_small_folder_that_would_fill_the_memory_is_not_unpacked(tmp_path, monkeypatch):
    shape = (50, 200, 200)
    create_stack(tmp_path / "black.zarr", shape, "uint8")
    write_stack(tmp_path / "black.zarr", 0, np.zeros(shape, np.uint8))
    assert not read_stack(tmp_path / "black.zarr", shape, "uint8").any()
    monkeypatch.setattr(stacks, "LARGEST_CONSTANT", 10**6)
    refused(tmp_path / "black.zarr", r"\d+ bytes of files would unpack to 2000000", shape)
