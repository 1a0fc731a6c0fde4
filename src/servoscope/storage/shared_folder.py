"""Where processes share arrays, and removing there what killed ones have left."""

from __future__ import annotations

import atexit
import os
import secrets
import shutil
import tempfile
from contextlib import ExitStack, suppress
from functools import cache
from pathlib import Path

from servoscope.storage.folders import locked

SHARED_MEMORY = Path("/dev/shm")  # noqa: S108  where Linux has it
_LEAST_FREE = 2 * 10**9
"""Shared memory with less room is left alone, [bytes]."""


@cache
def shared_folder() -> str:
    """A folder for arrays that processes share: in shared memory, where there is enough.

    It goes when this process ends. If that is killed, the next one that asks for such a folder
    removes it: its lock shows that the owner is gone.

    Raises
    ------
    OSError
        If there is no place for it.
    """
    remove_abandoned()
    owner = os.getpid()
    with ExitStack() as stack:
        while True:
            folder = _places()[0] / f"servoscope-{owner}-{secrets.token_hex(4)}"
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
