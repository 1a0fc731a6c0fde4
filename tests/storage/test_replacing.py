"""What is replaced stays whole until the new is, wherever it is interrupted."""

from pathlib import Path

import pytest

from servoscope.storage.replacing import NEW, complete_replacement, replacing

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


@pytest.mark.parametrize("n_renamed", range(12))
def test_a_process_that_ends_while_parts_are_renamed_loses_nothing(folder, monkeypatch, n_renamed):
    """The first rename decides: before it all is old, after it all becomes new."""
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
            mixed = {"old", "new"} <= set(read_parts(folder).values())
            assert not (mixed and (folder / "seal").exists())
    complete_replacement(folder, PARTS)
    assert read(folder) == (REPLACED if n_renamed else OLD)


def read_parts(folder: Path) -> dict[str, str]:
    return {
        part: (folder / part / "content").read_text() for part in PARTS if (folder / part).exists()
    }
