"""Processes that share work: gone with their owner, and a killed one is said so in a sentence."""

import os
import signal
import subprocess
import sys
import threading
import time
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
import pytest

import blas_sample
from servoscope.errors import ProcessesError
from servoscope.processes import in_processes, stop_processes
from servoscope.storage.folders import SHARED_MEMORY, remove_abandoned

OWNER = """
import os, sys, time
import numpy as np
from servoscope.processes import in_processes
from test_processes import sleep

array = np.ones(10**6)
for _ in in_processes(sleep, [(0.0, array)] * 4 + [(60.0, array)] * 4, n_jobs=2):
    print("begun", flush=True)
"""


def sleep(seconds: float, array: np.ndarray) -> float:
    time.sleep(seconds)
    return float(array[0])


def end_process(ends: bool) -> int:
    if ends:
        os.kill(os.getpid(), signal.SIGKILL)
    return os.getpid()


@pytest.fixture
def owner(tmp_path: Path):
    """A command whose processes sleep, and that shares an array with them."""
    environment = os.environ | {"JOBLIB_TEMP_FOLDER": str(tmp_path), "PYTHONPATH": "tests"}
    with subprocess.Popen(
        [sys.executable, "-c", OWNER],
        cwd=Path(__file__).parents[1],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    ) as process:
        assert process.stdout.readline() == b"begun\n"
        yield process


def of_session(leader: int) -> list[int]:
    """The processes of a session, but those that have ended."""
    listed = subprocess.run(
        ["ps", "-eo", "pid=,sess=,stat="], capture_output=True, text=True, check=True
    )
    rows = [line.split() for line in listed.stdout.splitlines()]
    return [int(pid) for pid, session, stat in rows if int(session) == leader and stat[0] != "Z"]


def wait_until_ended(leader: int) -> None:
    deadline = time.monotonic() + 10
    while of_session(leader):
        assert time.monotonic() < deadline, "they are still there after 10 s"
        time.sleep(0.1)


@pytest.mark.skipif(sys.platform == "win32", reason="needs ps")
def test_processes_end_soon_when_their_owner_is_killed(owner):
    assert len(of_session(owner.pid)) > 2
    owner.kill()
    owner.wait()
    wait_until_ended(owner.pid)


@pytest.mark.skipif(sys.platform == "win32", reason="needs process groups")
def test_what_a_group_shares_is_removed_by_the_next_once_it_was_killed(
    owner, tmp_path, monkeypatch
):
    monkeypatch.setenv("JOBLIB_TEMP_FOLDER", str(tmp_path))
    semaphores = f"sem.loky-{owner.pid}-*"
    assert list(tmp_path.rglob("*.pkl"))
    assert list(SHARED_MEMORY.glob(semaphores)) or sys.platform != "linux"
    before = sorted(tmp_path.rglob("*"))
    remove_abandoned()
    assert sorted(tmp_path.rglob("*")) == before
    os.killpg(owner.pid, signal.SIGKILL)
    owner.wait()
    wait_until_ended(owner.pid)
    assert sorted(tmp_path.rglob("*")) == before
    remove_abandoned()
    assert not list(tmp_path.iterdir())
    assert not list(SHARED_MEMORY.glob(semaphores))


def test_a_killed_process_is_one_sentence_and_others_can_be_started():
    with pytest.raises(ProcessesError, match=r"was killed, .*--jobs 1, a run with --resume\.$"):
        list(in_processes(end_process, [(i == 3,) for i in range(8)], n_jobs=2))
    assert os.getpid() not in in_processes(end_process, [(False,)] * 4, n_jobs=2)


def end_while_sending(ends: bool) -> bytes:
    """A result of which only a part is sent."""

    def send_a_part(connection: Connection, message: bytes) -> None:
        os.write(connection.fileno(), bytes(message[: len(message) // 2]))
        os.kill(os.getpid(), signal.SIGKILL)

    if ends:
        Connection._send = send_a_part
    return bytes(1000)


@pytest.mark.skipif(sys.platform == "win32", reason="there a message is sent whole, or not at all")
def test_a_process_killed_while_it_sends_is_the_same_sentence_and_not_waited_for():
    raised = []

    def call() -> None:
        try:
            list(in_processes(end_while_sending, [(i == 3,) for i in range(8)], n_jobs=2))
        except ProcessesError as error:
            raised.append(str(error))

    caller = threading.Thread(target=call, daemon=True)
    caller.start()
    caller.join(30)
    assert not caller.is_alive(), "it still waits after 30 s"
    assert "A process was killed" in raised[0]
    assert os.getpid() not in in_processes(end_process, [(False,)] * 4, n_jobs=2)


def fail_to_unpack() -> None:
    raise ValueError("not here")


class Unpackable:
    """What a process cannot take."""

    def __reduce__(self) -> tuple[object, tuple[()]]:
        return fail_to_unpack, ()


KEPT: list[np.ndarray] = []


def grow(n_bytes: int) -> int:
    """Keep so many bytes more; joblib looks at the memory once a second."""
    KEPT.append(np.ones(n_bytes, np.uint8))
    time.sleep(0.6)
    return os.getpid()


def test_processes_that_keep_what_they_need_again_are_not_ended():
    pytest.importorskip("psutil")
    calls = [(0,), (0,), *[(200_000_000,)] * 4, *[(0,)] * 4]
    try:
        pids = list(in_processes(grow, calls, n_jobs=2, batch_size=1))
    finally:
        stop_processes()
    assert len(set(pids)) <= 2


def test_arguments_that_a_process_cannot_take_are_not_said_to_be_a_want_of_memory():
    with pytest.raises(ProcessesError, match=r"^Processes failed \(.*un-serialize.*--jobs 1") as e:
        list(in_processes(str, [(Unpackable(),)] * 4, n_jobs=2))
    assert "memory" not in str(e.value)
    assert "\n" not in str(e.value)


WITHOUT_SEMAPHORES = """
import _multiprocessing, errno

class NoSemaphore(_multiprocessing.SemLock):
    def __new__(cls, *_, **__):
        raise OSError(errno.EROFS, "Read-only file system")

_multiprocessing.SemLock = NoSemaphore
from servoscope.processes import in_processes
print(list(in_processes(divmod, [(7, 2), (9, 4)], n_jobs=JOBS)))
"""


@pytest.mark.parametrize(("n_jobs", "n_warnings"), [(1, 0), (2, 1)])
def test_without_semaphores_one_process_does_all_and_says_so(n_jobs, n_warnings):
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_SEMAPHORES.replace("JOBS", str(n_jobs))],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == "[(3, 1), (2, 1)]\n"
    assert done.stderr.count("No processes can be started here") == n_warnings
    assert done.stderr.count("Warning") == n_warnings


def test_processes_that_cannot_be_started_are_one_sentence(monkeypatch):
    def fail(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("servoscope.processes.joblib.Parallel.__call__", fail)
    with pytest.raises(ProcessesError, match=r"started \(No space left on device\).*--jobs 1"):
        list(in_processes(divmod, [(7, 2)], n_jobs=2))


def test_any_number_of_blas_threads_gives_the_same():
    """Tests have one; `one_blas_thread` has to see to it where there are more."""
    done = subprocess.run(
        [sys.executable, blas_sample.__file__],
        env=os.environ | {"OPENBLAS_NUM_THREADS": "2"},
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )
    assert done.stdout.split() == blas_sample.digests()
