"""Folders that processes share, and what asks whether their owners are still there."""

import os

import pytest

from servoscope.storage import folders
from servoscope.storage.folders import locked


def leave_a_lock(folder, monkeypatch):
    monkeypatch.setenv("JOBLIB_TEMP_FOLDER", str(folder))
    lock = folder / f"servoscope-{2**22 + 1}-0.lock"
    lock.touch()
    lock.with_suffix("").mkdir()
    return lock


def test_without_shared_memory_no_process_is_signalled(tmp_path, monkeypatch):
    lock = leave_a_lock(tmp_path, monkeypatch)
    monkeypatch.setattr(folders, "SHARED_MEMORY", tmp_path / "none")
    monkeypatch.setattr(os, "kill", pytest.fail)
    folders.remove_abandoned()
    assert not lock.exists()
    assert not lock.with_suffix("").exists()


def test_semaphores_of_a_process_that_is_gone_are_removed(tmp_path, monkeypatch):
    lock = leave_a_lock(tmp_path, monkeypatch)
    monkeypatch.setattr(folders, "SHARED_MEMORY", tmp_path)
    owner = lock.name.split("-")[1]
    (tmp_path / f"sem.loky-{owner}-x").touch()
    (tmp_path / f"sem.loky-{os.getpid()}-x").touch()
    folders.remove_abandoned()
    assert [path.name for path in tmp_path.iterdir()] == [f"sem.loky-{os.getpid()}-x"]


def test_a_folder_that_cannot_be_made_leaves_no_lock(tmp_path, monkeypatch):
    monkeypatch.setenv("JOBLIB_TEMP_FOLDER", str(tmp_path))
    monkeypatch.setattr(folders.secrets, "token_hex", lambda _: "taken")
    folder = tmp_path / f"servoscope-{os.getpid()}-taken"
    folder.mkdir()
    with pytest.raises(FileExistsError):
        folders.shared_folder.__wrapped__()
    with locked(folder.with_name(f"{folder.name}.lock")) as is_free:
        assert is_free
    assert not folder.with_name(f"{folder.name}.lock").exists()
