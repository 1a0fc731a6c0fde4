"""Files written whole or not at all; folders with one owner, replaced as a whole or shared.

A lock is let go of by the operating system when its process ends. A replacement that was stopped is
completed by whoever comes next. Where processes share arrays, what killed ones left is removed.
"""

from __future__ import annotations

import atexit
import errno
import json
import os
import re
import secrets
import shutil
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from os import PathLike
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import FolderExistsError, FolderInUseError, InvalidInputError
from servoscope.wording import one_line


def write_atomically(path: Path, write: Callable[[BinaryIO], object]) -> None:
    """Call ``write(file)`` on a temporary file beside `path`, then rename it to `path`.

    Whatever goes wrong on the way, `path` is what it was before.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with open(temporary, "wb") as file:
            write(file)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def remove_parts(folder: Path) -> None:
    """Remove what interrupted writes have left in a folder."""
    for part in folder.glob(".*.part"):
        part.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 text, whole or not at all."""
    write_atomically(path, lambda file: file.write(text.encode()))


def write_json(path: Path, value: Any) -> None:
    """Write strict JSON (no NaN), whole or not at all."""
    write_text(path, to_json(value) + "\n")


def to_json(value: Any) -> str:
    """Strict JSON (no NaN) of plain values and of numpy's."""
    return json.dumps(value, indent=1, allow_nan=False, default=_plain)


def write_arrays(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write an uncompressed ``.npz``, whole or not at all; equal arrays give equal bytes."""
    if any(array.dtype.hasobject for array in arrays.values()):
        raise TypeError("Arrays of Python objects cannot be written without pickle.")

    def write(file: BinaryIO) -> None:
        with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
            for name, array in arrays.items():
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    plain = np.asarray(array, order="C")
                    np.lib.format.write_array(member, plain, allow_pickle=False)

    write_atomically(path, write)


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} has no place in a JSON file.")


LOCK = ".servoscope.lock"
"""The file in a folder that its owner has locked."""

_OTHERS = {errno.EACCES, errno.EAGAIN, errno.EDEADLK}
_NO_LOCKS = {errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP}


_ADDRESS = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+:/")


def check_local(folder: str | PathLike[str]) -> None:
    """Raise InvalidInputError if what is to be written to is an address of another file system.

    A path would make a folder of that name here.
    """
    if _ADDRESS.match(os.fspath(folder)):
        raise InvalidInputError(
            f"{folder} is an address, and nothing is written to addresses; name a folder, and copy "
            "it there."
        )


@contextmanager
def owned(folder: str | PathLike[str], *, beside: bool = False) -> Iterator[None]:
    """Own a folder, which is made if it is not there; it is left as it was if nothing is written.

    With `beside` a file beside the folder is locked, and the folder not made, rather than one in
    it.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder, owned(folder):
    ...     (Path(folder) / LOCK).exists()
    True
    """
    check_local(folder)
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

    The folder is owned, and what else is in it stays. The first of the parts shows that the others
    are whole: it leaves first and enters last. With `go_on` the block goes on with what an earlier
    one has left; with `keep` what was made is left if the block fails.
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

    If it goes on right now, or the folder cannot be written, that is a `FolderInUseError`.
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


SHARED_MEMORY = Path("/dev/shm")  # noqa: S108  where Linux has it
_LEAST_FREE = 2 * 10**9
"""Shared memory with less room is left alone, [bytes]."""


@cache
def shared_folder() -> str:
    """A folder for arrays that processes share:

    in shared memory, where there is enough. It goes when this process ends. If that is killed, the
    next one that asks for such a folder removes it: its lock shows that the owner is gone.
    """
    return _own_folder(_places()[0])


@cache
def scratch_folder() -> str:
    """A folder on disk for what the memory does not hold; it goes as `shared_folder` does."""
    return _own_folder(Path(tempfile.gettempdir()))


def _own_folder(place: Path) -> str:
    remove_abandoned()
    owner = os.getpid()
    with ExitStack() as stack:
        while True:
            folder = place / f"servoscope-{owner}-{secrets.token_hex(4)}"
            if stack.enter_context(locked(_lock_of(folder))):
                break
        folder.mkdir(mode=0o700)
        stack.callback(shutil.rmtree, folder, ignore_errors=True)
        held = stack.pop_all()
    atexit.register(lambda: held.close() if os.getpid() == owner else None)
    return str(folder)


def remove_abandoned() -> None:
    """Remove the shared folders and the semaphores of processes of this user that were killed."""
    with suppress(OSError):
        for place in _places():
            for lock in place.glob("servoscope-*-*.lock"):
                with suppress(OSError, ValueError):
                    _remove_if_abandoned(lock)


def _remove_if_abandoned(lock: Path) -> None:
    if hasattr(os, "getuid") and lock.lstat().st_uid != os.getuid():
        return
    owner = int(lock.name.split("-")[1])
    with locked(lock) as is_abandoned:
        if not is_abandoned:
            return
        shutil.rmtree(lock.with_suffix(""), ignore_errors=True)
        # Windows has no such folder, and there the question would be a Ctrl-C.
        if SHARED_MEMORY.is_dir() and not _is_alive(owner):
            for semaphore in SHARED_MEMORY.glob(f"sem.loky-{owner}-*"):
                semaphore.unlink(missing_ok=True)


def _places() -> list[Path]:
    """Folders that may hold shared ones, that for the next first."""
    chosen = os.environ.get("JOBLIB_TEMP_FOLDER")
    places = [Path(chosen)] if chosen else []
    with suppress(OSError, AttributeError):
        stats = os.statvfs(SHARED_MEMORY)
        if stats.f_bavail * stats.f_frsize > _LEAST_FREE and os.access(SHARED_MEMORY, os.W_OK):
            places.append(SHARED_MEMORY)
    return [*places, Path(tempfile.gettempdir())]


def _lock_of(folder: Path) -> Path:
    return folder.with_name(f"{folder.name}.lock")


def _is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        pass
    return True
