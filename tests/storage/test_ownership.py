"""A folder has one owner, for as long as that lives."""

import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from servoscope.errors import FolderExistsError, FolderInUseError
from servoscope.storage.ownership import LOCK, locked, owned

OWNER = """
import sys, time
from servoscope.storage.ownership import owned
with owned(sys.argv[1]):
    print("owned", flush=True)
    time.sleep(60)
"""


@pytest.fixture
def owner(tmp_path: Path):
    """Another process that owns a folder."""
    command = [sys.executable, "-c", OWNER, str(tmp_path / "folder")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "owned\n"
        yield process
        process.kill()


def test_a_second_owner_is_refused_at_once(owner, tmp_path):
    start = time.monotonic()
    refused = pytest.raises(FolderInUseError, match="folder is being written by another command")
    with refused, owned(tmp_path / "folder"):
        pass
    assert time.monotonic() - start < 1


def test_a_killed_owner_stands_in_nobodys_way(owner, tmp_path):
    owner.kill()
    owner.wait()
    with owned(tmp_path / "folder"):
        assert (tmp_path / "folder" / LOCK).exists()
    assert not (tmp_path / "folder" / LOCK).exists()


def test_a_link_to_a_folder_is_that_folder(owner, tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "folder")
    with pytest.raises(FolderInUseError), owned(tmp_path / "link"):
        pass


def test_a_folder_in_which_nothing_is_written_goes_again(tmp_path):
    with owned(tmp_path / "a" / "b"):
        pass
    assert not list(tmp_path.iterdir())


def test_what_is_written_stays(tmp_path):
    with owned(tmp_path / "folder"):
        (tmp_path / "folder" / "file").write_text("kept")
    assert [path.name for path in (tmp_path / "folder").iterdir()] == ["file"]


def test_a_folder_may_be_owned_that_is_yet_to_be_renamed_to(tmp_path):
    with owned(tmp_path / "model", beside=True):
        (tmp_path / "part").mkdir()
        (tmp_path / "part").rename(tmp_path / "model")
        with pytest.raises(FolderInUseError), owned(tmp_path / "model", beside=True):
            pass
    assert [path.name for path in tmp_path.iterdir()] == ["model"]


def test_a_file_is_no_folder(tmp_path):
    (tmp_path / "file").write_text("mine")
    refused = pytest.raises(FolderExistsError, match="file is a file; name a folder")
    with refused, owned(tmp_path / "file"):
        pass


def test_never_two_hold_a_lock_that_is_made_and_removed_all_the_time(tmp_path):
    inside, most, taken = [], [], []

    def take() -> None:
        end = time.monotonic() + 0.5
        while time.monotonic() < end:
            with locked(tmp_path / "lock") as is_mine:
                if is_mine:
                    inside.append(1)
                    most.append(len(inside))
                    taken.append(1)
                    inside.pop()

    threads = [threading.Thread(target=take) for _ in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(taken) > 10
    assert max(most) == 1
