import io
import struct
import zipfile

import numpy as np
import pytest

from servoscope.errors import RunFolderError
from servoscope.storage.archives import MOST_MEMBERS, read_arrays
from servoscope.storage.folders import write_arrays


def archive(path, members, compression=zipfile.ZIP_STORED):
    with zipfile.ZipFile(path, "w", compression) as file:
        for name, content in members.items():
            file.writestr(name, content)
    return path


def npy(array):
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def refused(path, match, names=("x",)):
    with pytest.raises(RunFolderError, match=match) as caught:
        read_arrays(path, names, RunFolderError)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "array",
    [
        np.arange(6.0).reshape(2, 3),
        np.asfortranarray(np.arange(6).reshape(2, 3)),
        np.array(["theta_150", "e_07"]),
        np.empty((0, 4)),
        np.array(3.5),
        np.array([True, False]),
    ],
)
def test_arrays_come_back_as_numpy_reads_them(tmp_path, array):
    write_arrays(tmp_path / "a.npz", {"x": array, "y": np.zeros(1)})
    with np.load(tmp_path / "a.npz", allow_pickle=False) as expected:
        read = read_arrays(tmp_path / "a.npz", ["x"], RunFolderError)
        np.testing.assert_array_equal(read["x"], expected["x"])
        assert read["x"].dtype == expected["x"].dtype
    assert read_arrays(tmp_path / "a.npz", None, RunFolderError).keys() == {"x", "y"}


def test_what_unpacks_to_more_than_the_file_is_not_unpacked(tmp_path):
    bomb = archive(tmp_path / "a.npz", {"x.npy": npy(np.zeros(10**6))}, zipfile.ZIP_DEFLATED)
    assert bomb.stat().st_size < 10_000
    refused(bomb, "'x' is compressed")


def test_a_head_that_declares_more_than_there_is_is_refused(tmp_path):
    content = npy(np.zeros(1)).replace(b"(1,), }          ", b"(10000000000,), }")
    refused(archive(tmp_path / "a.npz", {"x.npy": content}), "not as long as it declares")


def test_objects_are_refused(tmp_path):
    file = io.BytesIO()
    np.save(file, np.array([{}], dtype=object), allow_pickle=True)
    refused(archive(tmp_path / "a.npz", {"x.npy": file.getvalue()}), "not of numbers|as long as")


def test_members_are_counted_before_they_are_listed(tmp_path):
    members = {f"{i}.npy": b"" for i in range(MOST_MEMBERS + 1)}
    refused(archive(tmp_path / "a.npz", members), f"has {MOST_MEMBERS + 1} members")


def with_end(path, change):
    """An archive of many members whose end record is changed."""
    archive(path, {f"{i}.npy": b"" for i in range(100)})
    content = path.read_bytes()
    path.write_bytes(content[:-22] + change(content[-22:]))
    return path


def declaring(n_members):
    count = struct.pack("<HH", n_members, n_members)
    return lambda end: end[:8] + count + end[12:]


def test_more_members_than_are_declared_are_not_listed(tmp_path, monkeypatch):
    monkeypatch.setattr(zipfile.ZipFile, "_RealGetContents", pytest.fail)
    refused(with_end(tmp_path / "a.npz", declaring(1)), "lists 1 members in [0-9]+ bytes")
    refused(with_end(tmp_path / "a.npz", declaring(0)), "lists 0 members in [0-9]+ bytes")


def test_a_second_end_record_that_zipfile_would_follow_is_refused(tmp_path):
    locator = b"PK\6\7" + bytes(16)
    refused(with_end(tmp_path / "a.npz", lambda end: locator + end), "no archive of arrays")
    refused(with_end(tmp_path / "b.npz", lambda end: end[:-2] + b"\1\0"), "no archive of arrays")


@pytest.mark.parametrize("content", [b"", b"PK", b"PK\5\6" + bytes(18), b"x" * 100])
def test_what_is_no_archive_is_refused(tmp_path, content):
    (tmp_path / "a.npz").write_bytes(content)
    refused(tmp_path / "a.npz", r"a\.npz cannot be read")


def test_a_lost_file_and_a_lost_array_are_named(tmp_path):
    refused(tmp_path / "a.npz", r"a\.npz is missing")
    refused(archive(tmp_path / "a.npz", {"y.npy": npy(np.zeros(1))}), r"x\.npy")
