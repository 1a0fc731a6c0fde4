"""One owner a folder, and parts that are replaced whole or not at all."""

import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from servoscope.errors import FolderExistsError, FolderInUseError
from servoscope.storage.folders import (
    LOCK,
    NEW,
    complete_interrupted,
    complete_replacement,
    locked,
    owned,
    replacing,
)

OWNER = """
import sys, time
from servoscope.storage.folders import owned
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


PARTS = ("seal", "array", "table", "gone", "more")


def write(folder: Path, parts: tuple[str, ...], content: str) -> None:
    for part in parts:
        (folder / part).mkdir()
        (folder / part / "content").write_text(content)


def read(folder: Path) -> dict[str, str]:
    parts = [part for part in folder.iterdir() if part.name != NEW]
    return {part.name: (part / "content").read_text() for part in parts}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write(tmp_path, ("seal", "array", "table", "gone"), "old")
    write(tmp_path, ("notes",), "mine")
    return tmp_path


REPLACED = {"seal": "new", "array": "new", "table": "new", "more": "new", "notes": "mine"}
OLD = {"seal": "old", "array": "old", "table": "old", "gone": "old", "notes": "mine"}


def replace(folder: Path) -> None:
    with replacing(folder, PARTS) as place:
        write(place, ("seal", "array", "table", "more"), "new")


def fail(folder: Path, error: BaseException, **options: bool) -> None:
    with replacing(folder, PARTS, **options) as place:
        write(place, ("array", "table"), "new")
        raise error


def test_parts_are_replaced_and_nothing_else(folder):
    replace(folder)
    assert read(folder) == REPLACED


@pytest.mark.parametrize("error", [OSError(28, "No space left"), KeyboardInterrupt()])
def test_a_block_that_fails_replaces_nothing(folder, error):
    with pytest.raises(type(error)):
        fail(folder, error)
    assert read(folder) == OLD
    assert not (folder / NEW).exists()


def test_what_was_made_is_gone_on_with_if_it_is_kept(folder):
    with pytest.raises(KeyboardInterrupt):
        fail(folder, KeyboardInterrupt(), keep=True)
    with replacing(folder, PARTS, go_on=True) as place:
        write(place, ("more", "seal"), "new")
    assert read(folder) == REPLACED


def end_after(n_renamed: int, folder: Path, monkeypatch: pytest.MonkeyPatch) -> bool:
    """Replace, but end after some renames; whether there were more to do."""
    rename, left = Path.rename, n_renamed

    def rename_or_end(self: Path, target: Path) -> Path:
        nonlocal left
        if not left:
            raise KeyboardInterrupt
        left -= 1
        return rename(self, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "rename", rename_or_end)
        try:
            replace(folder)
        except KeyboardInterrupt:
            return True
    return False


@pytest.mark.parametrize("n_renamed", range(12))
def test_a_process_that_ends_while_parts_are_renamed_loses_nothing(folder, monkeypatch, n_renamed):
    """The first rename decides: before it all is old, after it all becomes new."""
    if end_after(n_renamed, folder, monkeypatch):
        mixed = {"old", "new"} <= set(read_parts(folder).values())
        assert not (mixed and (folder / "seal").exists())
    complete_replacement(folder, PARTS)
    assert read(folder) == (REPLACED if n_renamed else OLD)


def test_who_reads_completes_what_was_interrupted_unless_it_goes_on(folder, monkeypatch):
    complete_interrupted(folder, PARTS)
    assert read(folder) == OLD
    assert end_after(3, folder, monkeypatch)
    with owned(folder), pytest.raises(FolderInUseError, match="another command; wait"):
        complete_interrupted(folder, PARTS)
    complete_interrupted(folder, PARTS)
    assert read(folder) == REPLACED


def test_what_cannot_be_completed_is_said_in_a_line(folder, monkeypatch):
    assert end_after(3, folder, monkeypatch)

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied", "x")

    monkeypatch.setattr("servoscope.storage.folders.os.open", refuse)
    with pytest.raises(FolderInUseError, match=r"\(Permission denied\); make it writable"):
        complete_interrupted(folder, PARTS)


def test_a_failed_block_waits_for_nobody_that_is_gone(folder, monkeypatch):
    monkeypatch.setattr("servoscope.storage.folders.time", SimpleNamespace(sleep=pytest.fail))
    with pytest.raises(ValueError, match="wrong"):
        fail(folder, ValueError("wrong"))


def read_parts(folder: Path) -> dict[str, str]:
    return {
        part: (folder / part / "content").read_text() for part in PARTS if (folder / part).exists()
    }
