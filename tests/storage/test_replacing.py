"""What is replaced stays whole until the new is, wherever it is interrupted."""

from pathlib import Path

import pytest

from servoscope.errors import FolderInUseError
from servoscope.storage.ownership import owned
from servoscope.storage.replacing import (
    NEW,
    complete_interrupted,
    complete_replacement,
    replacing,
)

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

    monkeypatch.setattr("servoscope.storage.ownership.os.open", refuse)
    with pytest.raises(FolderInUseError, match=r"\(Permission denied\); make it writable"):
        complete_interrupted(folder, PARTS)


def test_a_failed_block_waits_for_nobody_that_is_gone(folder, monkeypatch):
    monkeypatch.setattr("servoscope.storage.replacing.time.sleep", pytest.fail)
    with pytest.raises(ValueError, match="wrong"):
        fail(folder, ValueError("wrong"))


def read_parts(folder: Path) -> dict[str, str]:
    return {
        part: (folder / part / "content").read_text() for part in PARTS if (folder / part).exists()
    }
