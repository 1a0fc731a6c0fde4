"""What a folder holds stays whole until what replaces it is whole.

The new is made in a folder of its own within the old one. Once it is whole, that folder is
renamed, from which moment on the replacement is completed whatever happens: the old parts leave,
then the new ones move in, all by renaming.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from servoscope.errors import FolderInUseError
from servoscope.storage.ownership import owned
from servoscope.wording import one_line

NEW = ".servoscope-new"
"""The folder within a folder in which its replacement is made."""

_WHOLE, _ENTERING, _OLD = ".servoscope-whole", ".servoscope-entering", ".servoscope-old"


@contextmanager
def replacing(
    folder: Path, parts: Sequence[str], *, go_on: bool = False, keep: bool = False
) -> Iterator[Path]:
    """Where to make what is to replace the parts of a folder; it does so once the block ends well.

    Parameters
    ----------
    folder : Path
        Owned; what else is in it stays.
    parts : sequence of str
        Files and folders in there that are replaced. The first shows that the others are whole:
        it leaves first and enters last.
    go_on : bool
        Go on with what an earlier block has left.
    keep : bool
        Leave what was made if the block fails.
    """
    new = folder / NEW
    if not go_on:
        shutil.rmtree(new, ignore_errors=True)
    new.mkdir(exist_ok=True)
    try:
        yield new
    except BaseException:
        if not keep:
            _remove(new)
        raise
    new.rename(folder / _WHOLE)
    complete_replacement(folder, parts)


def complete_replacement(folder: Path, parts: Sequence[str]) -> None:
    """Complete a replacement that was stopped in its last step, if there is one."""
    whole, entering, old = folder / _WHOLE, folder / _ENTERING, folder / _OLD
    if whole.exists():
        old.mkdir(exist_ok=True)
        for part in parts:
            if (folder / part).exists():
                (folder / part).rename(old / part)
        whole.rename(entering)
    if entering.exists():
        for part in reversed(parts):
            if (entering / part).exists():
                (entering / part).rename(folder / part)
        shutil.rmtree(entering)
    shutil.rmtree(old, ignore_errors=True)


def complete_interrupted(folder: Path, parts: Sequence[str]) -> None:
    """Complete a replacement that was stopped in its last step, in a folder that is not owned.

    Raises
    ------
    FolderInUseError
        If there is one and it cannot be completed: it goes on right now, or the folder cannot be
        written.
    """
    if not any((folder / name).exists() for name in (_WHOLE, _ENTERING)):
        return
    try:
        with owned(folder):
            complete_replacement(folder, parts)
    except OSError as error:
        raise FolderInUseError(
            f"{folder} was being replaced when that was interrupted, which cannot be completed "
            f"({one_line(error.strerror or error)}); make it writable, or repeat the command that "
            "was interrupted."
        ) from error


def _remove(folder: Path) -> None:
    """Remove a folder in which threads of a writer that failed may still be writing."""
    for _ in range(20):
        shutil.rmtree(folder, ignore_errors=True)
        if not folder.exists():
            return
        time.sleep(0.1)
