"""Folders with one owner, replaced as a whole.

A lock is let go of by the operating system when its process ends. A replacement that was stopped is
completed by whoever comes next.
"""

from __future__ import annotations

import errno
import os
import shutil
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from os import PathLike
from pathlib import Path

from servoscope.errors import FolderExistsError, FolderInUseError
from servoscope.wording import one_line

LOCK = ".servoscope.lock"
"""The file in a folder that its owner has locked."""

_OTHERS = {errno.EACCES, errno.EAGAIN, errno.EDEADLK}
_NO_LOCKS = {errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP}


@contextmanager
def owned(folder: str | PathLike[str], *, beside: bool = False) -> Iterator[None]:
    """Own a folder, which is made if it is not there; it is left as it was if nothing is written.

    Parameters
    ----------
    folder : path
    beside : bool
        Lock a file beside the folder, which is then not made, rather than one in it.

    Raises
    ------
    FolderInUseError
        If another process, or another thread of this one, owns it.
    FolderExistsError
        If it is a file.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder, owned(folder):
    ...     (Path(folder) / LOCK).exists()
    True
    """
    path = Path(os.path.realpath(folder))
    inside = path.parent if beside else path
    made = [place for place in (inside, *inside.parents) if not place.exists()]
    try:
        inside.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise FolderExistsError(f"{folder} is a file; name a folder.") from None
    lock = path.with_name(f".{path.name}{LOCK}") if beside else path / LOCK
    try:
        with locked(lock) as is_locked:
            if not is_locked:
                raise FolderInUseError(
                    f"{folder} is being written by another command; wait until it has ended, or "
                    "name another folder."
                )
            yield
    finally:
        with suppress(OSError):
            for place in made:
                place.rmdir()


@contextmanager
def locked(path: Path) -> Iterator[bool]:
    """Lock a file, made for that; yields whether it could be, or was locked by somebody else.

    The file is removed in the end. A process that is killed leaves it, unlocked. Where a file
    system knows no locks, all get one.
    """
    file = _open_locked(path)
    try:
        yield file is not None
    finally:
        if file is not None:
            _remove(path, file)


def _open_locked(path: Path) -> int | None:
    """The file, open and locked, or None if it is locked already."""
    flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0)
    while True:
        file = os.open(path, flags, 0o666)
        try:
            if not _lock(file):
                os.close(file)
                return None
            if os.path.samestat(os.fstat(file), os.stat(path)):
                return file
        except FileNotFoundError:
            pass  # its owner removed it between the two: the next one there is another
        except BaseException:
            os.close(file)
            raise
        os.close(file)


def _lock(file: int) -> bool:
    """Lock an open file, if nobody has."""
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(file, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in _OTHERS:
            return False
        if error.errno not in _NO_LOCKS:
            raise
    return True


def _remove(path: Path, file: int) -> None:
    """Remove the file and unlock it, in the order that the system allows."""
    if sys.platform == "win32":  # an open file cannot be removed there
        os.close(file)
    with suppress(OSError):
        path.unlink()
    if sys.platform != "win32":
        os.close(file)


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
            _remove_folder(new)
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


def _remove_folder(folder: Path) -> None:
    """Remove a folder in which threads of a writer that failed may still be writing."""
    for _ in range(20):
        shutil.rmtree(folder, ignore_errors=True)
        if not folder.exists():
            return
        time.sleep(0.1)
