"""One owner a folder: a lock that the operating system lets go of when its process ends."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from os import PathLike
from pathlib import Path

from servoscope.errors import FolderExistsError, FolderInUseError

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
