"""Data sets at addresses: in fsspec's memory, and at a real S3 server on loopback."""

import json
import pickle
from pathlib import Path

import numpy as np
import pytest

from planar import planar_data_set
from servoscope.cli import main
from servoscope.data.images import PoseImageSet
from servoscope.errors import DataSetError, InvalidInputError
from servoscope.processes import in_processes
from servoscope.storage import addresses
from servoscope.storage.addresses import absolute, place_of
from servoscope.storage.folders import scratch_folder
from servoscope.storage.run_folder import read_json

fsspec = pytest.importorskip("fsspec")

SMALL = "1MB"  # of which a quarter is kept: images of more are a stack


@pytest.fixture(scope="module")
def data():
    """300 images that take more than a quarter of a megabyte, in 12 chunks."""
    return planar_data_set(300, 32)


@pytest.fixture(scope="module")
def folder(data, tmp_path_factory):
    place = tmp_path_factory.mktemp("set") / "set"
    data.save(place)
    return place


@pytest.fixture
def in_memory(folder):
    """The same in the memory of fsspec: its address and its file system."""
    memory = fsspec.filesystem("memory")
    memory.put(str(folder), "/cell/set", recursive=True)
    yield "memory://cell/set", memory
    memory.rm("/cell", recursive=True)


def is_same(data, other):
    assert data.fingerprint() == other.fingerprint()
    assert list(data.names) == list(other.names)
    np.testing.assert_array_equal(data.T_world_cam, other.T_world_cam)


def nothing_is_left():
    return not list(Path(scratch_folder()).iterdir())


@pytest.mark.parametrize("memory", [None, SMALL])
def test_a_set_in_another_file_system_is_the_same_set(in_memory, folder, memory):
    address, _ = in_memory
    data = PoseImageSet.load(address, memory=memory)
    assert isinstance(data.images, np.ndarray) is (memory is None)
    is_same(data, PoseImageSet.load(folder))
    assert nothing_is_left()


def test_commands_read_sets_at_addresses(in_memory, folder, tmp_path, capsys):
    address, _ = in_memory
    described = []
    for place in (address, str(folder)):
        assert main(["info", place, "--json"]) == 0
        described.append({**json.loads(capsys.readouterr().out), "data_set": place})
    assert described[0] == {**described[1], "data_set": address}
    lost = "memory://lost/set"
    for command in (
        ["train", str(folder), "--add", lost, "--out", str(tmp_path / "model")],
        ["info", lost],
    ):
        assert main(command) == 1
        assert f"servoscope: {lost} is not a data set folder" in capsys.readouterr().err


def test_a_file_address_is_the_folder_and_a_path_stays_one(folder):
    is_same(PoseImageSet.load(folder.as_uri()), PoseImageSet.load(folder))
    assert place_of("file:///sets/a?b#c") == Path("/sets/a?b#c")
    assert place_of("file://localhost/sets/a%20b") == Path("/sets/a b")
    assert place_of("C:/sets/a") == Path("C:/sets/a")
    assert absolute("memory://a/b/") == "memory://a/b"
    assert absolute("a") == str(Path("a").resolve())


def test_only_the_chunks_that_are_asked_for_are_fetched(in_memory, data, monkeypatch):
    address, _ = in_memory
    stack = PoseImageSet.load(address, memory=SMALL).images
    asked, copy = [], addresses._copy

    def copied(at, largest, place):
        asked.extend(largest)
        copy(at, largest, place)

    monkeypatch.setattr(addresses, "_copy", copied)
    some = np.array([260, 3, 259, 3])
    np.testing.assert_array_equal(stack[some], data.images[some])
    np.testing.assert_array_equal(stack.take(some).flat()[1], data.images[3].ravel())
    assert sorted(set(asked)) == ["c/0/0/0", "c/10/0/0"]


def test_a_stack_goes_to_another_process_as_its_address(in_memory, data):
    stack = PoseImageSet.load(in_memory[0], memory=SMALL).images
    sent = pickle.dumps(stack)
    assert len(sent) < 10_000 < data.images.nbytes
    np.testing.assert_array_equal(pickle.loads(sent)[:], data.images)  # noqa: S301


CHUNK = "/cell/set/images.zarr/c/4/0/0"


def lose(memory):
    memory.rm(CHUNK)


def bloat(memory):
    memory.pipe(CHUNK, bytes(10_000_000))


def cut(memory):
    memory.pipe(CHUNK, memory.cat(CHUNK)[:-1])


def garble(memory):
    content = memory.cat(CHUNK)
    memory.pipe(CHUNK, content[:90] + bytes([content[90] ^ 1]) + content[91:])


def lengthen(memory):
    memory.pipe("/cell/set/meta.json", bytes(9 * 2**20))


def forget(memory):
    memory.rm("/cell/set/meta.json")


@pytest.mark.parametrize(
    ("harm", "words"),
    [
        (lose, r"images\.zarr cannot be read \(1 of 12 chunks are missing\)"),
        (bloat, r"c/4/0/0 has more than \d+ bytes"),
        (cut, r"images\.zarr cannot be read \(c/4/0/0 declares"),
        (garble, r"images\.zarr cannot be read"),
        (lengthen, r"meta\.json has more than \d+ bytes \(9437184\)"),
        (forget, r"is not a data set folder: it has no meta\.json"),
    ],
)
def test_what_is_damaged_is_one_line_that_names_the_address(in_memory, harm, words):
    address, memory = in_memory
    harm(memory)
    with pytest.raises(DataSetError, match=f"^{address}.*{words}") as caught:
        np.asarray(PoseImageSet.load(address, memory=SMALL).images)
    assert "\n" not in str(caught.value)
    assert scratch_folder() not in str(caught.value)
    assert nothing_is_left()


def test_a_server_that_lists_no_sizes_is_refused_in_one_line(in_memory, monkeypatch):
    address, memory = in_memory
    monkeypatch.setattr(memory, "find", lambda path, detail: {f"{path}/0/0/0": {"size": None}})
    with pytest.raises(DataSetError, match=f"^{address}.* does not list the sizes") as caught:
        PoseImageSet.load(address)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("memory://nowhere/set", "is not a data set folder"),
        ("nosuch://a/b", "cannot be read .* see that it is the address"),
        ("zip://a/b", "cannot be read .* see that it is the address"),
        ("ftp://127.0.0.1:1/a", "cannot be read .* see that it is the address"),
        ("jupyter://127.0.0.1:1/a", "cannot be read .* see that it is the address"),
        ("simplecache::memory://cell/set", "is not followed"),
        ("reference://cell", "is not followed"),
        ("file://a/b", "another machine"),
        ("file://a", "another machine"),
    ],
)
def test_addresses_that_lead_nowhere_are_refused(address, words):
    with pytest.raises(DataSetError, match=words):
        PoseImageSet.load(address)


@pytest.mark.parametrize("command", [["import", "folder", "x"], ["acquire"]])
def test_nothing_is_written_to_an_address(command, data, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InvalidInputError, match="nothing is written to addresses"):
        data.save("s3://bucket/set")
    assert main([*command, "s3://bucket/set"]) == 1
    assert "is an address, and nothing is written to addresses" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.fixture(scope="module")
def s3(folder, tmp_path_factory):
    """Two data sets in a bucket of a real server, found by the usual variables; its address."""
    pytest.importorskip("s3fs", reason="needs the extra cloud")
    server = pytest.importorskip("moto.server", reason="needs moto and flask")
    few = tmp_path_factory.mktemp("few") / "few"
    planar_data_set(60, 16).save(few)
    running = server.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    running.start()
    host, port = running.get_host_and_port()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
        patch.setenv("AWS_DEFAULT_REGION", "us-east-1")
        for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
            patch.setenv(name, "testing")
        files = fsspec.filesystem("s3", skip_instance_cache=True)
        files.mkdir("bucket")
        files.put(str(folder), "bucket/set", recursive=True)
        files.put(str(few), "bucket/few", recursive=True)
        yield "s3://bucket"
        type(files).clear_instance_cache()
    running.stop()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_workers_read_their_own_blocks_of_a_set_in_a_bucket(s3, folder, data):
    pytest.importorskip("distributed")
    from servoscope.cluster import on_cluster

    found = PoseImageSet.load(f"{s3}/set", memory=SMALL)
    is_same(found, PoseImageSet.load(folder))
    blocks = np.array_split(np.arange(300), 4)
    with on_cluster(n_workers=1):
        read = list(in_processes(np.asarray, [(found.images.take(block),) for block in blocks]))
    np.testing.assert_array_equal(np.concatenate(read), data.images)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_sets_in_a_bucket_are_assessed_and_one_that_is_not_there_is_a_row(s3, tmp_path):
    run = tmp_path / "run"
    command = ["assess", f"{s3}/few", f"{s3}/lost", "--out", str(run), "--jobs", "1"]
    command += ["--families", "moments", "--dofs", "tx", "--regressor", "kernel_ridge"]
    assert main(command) == 1
    lost, found = read_json(run / "summary.json")["sets"]
    assert lost["error"].startswith("s3://bucket/lost is not a data set folder")
    assert (found["dataset"], found["n_images"], found["run"]) == (f"{s3}/few", 60, "sets/few")
    settings = read_json(run / "sets" / "few" / "config.json")["settings"]
    assert settings["dataset"] == f"{s3}/few"
