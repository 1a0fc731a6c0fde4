"""Calls shared among processes, how far they are, and BLAS kept to one thread."""

from __future__ import annotations

import gc
import os
import queue
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from functools import cache
from multiprocessing.connection import wait
from typing import Any
from weakref import WeakSet

from threadpoolctl import ThreadpoolController

from servoscope.cluster import current
from servoscope.errors import ProcessesError, ProcessKilledError, ServoscopeWarning
from servoscope.storage.folders import shared_folder
from servoscope.wording import one_line

Advance = Callable[[int], object]
"""Called with the number of items that are finished."""

ProgressBar = Callable[[str, int | None], AbstractContextManager[Advance]]
"""Opens a progress bar, given what is done and how many items that has; yields an `Advance`."""


def no_progress(description: str, total: int | None) -> AbstractContextManager[Advance]:
    """A progress bar that nobody sees."""
    return nullcontext(lambda n_done: None)


with warnings.catch_warnings():
    warnings.filterwarnings("ignore", message=".*joblib will operate in serial mode")
    import joblib

WATCH_INTERVAL = 0.5
"""How often a process looks whether the one that started it is still there, and that one whether
its processes are, [s]."""


class _Parallel(joblib.Parallel):
    """joblib's, given up without a traceback of the thread that hands out its calls.

    joblib forgets the calls before their numbers, and then looks for a call whose number was left.
    """

    def _abort(self) -> None:
        with self._lock:
            self._aborting = True  # no call is added from here on
        executor = getattr(self._backend, "_workers", None)
        if executor is None:
            return
        with suppress(queue.Empty):
            while True:
                executor._work_ids.get_nowait()
        super()._abort()


_parallels: WeakSet[_Parallel] = WeakSet()
"""Those that may still have calls to make."""


def in_processes(
    function: Callable[..., Any],
    calls: Iterable[tuple[Any, ...]],
    n_jobs: int | None = -1,
    *,
    in_order: bool = True,
    **options: Any,
) -> Iterator[Any]:
    """What `function` returns for each tuple of arguments, in their order or as it is ready.

    The processes have one BLAS thread each, leave Ctrl-C to this one, and end when it does, however
    it ends. Where no process can be started, this one does all. Within
    `servoscope.cluster.on_cluster` the workers of a cluster take their place. Everywhere in the
    package `n_jobs` counts processes as joblib does, -1 for all cores, 1 or None for this process
    alone, and changes no number; `on_progress` is called with the number of items that are
    finished.

    Raises
    ------
    ProcessesError
        If the processes cannot be started, or one of them cannot take its arguments; a
        `ProcessKilledError` if one is killed.

    Examples
    --------
    >>> list(in_processes(divmod, [(7, 2), (9, 4)], n_jobs=1))
    [(3, 1), (2, 1)]
    """
    if n_jobs not in (None, 1) and (cluster := current()) is not None:
        return cluster.results(function, calls, in_order=in_order)
    n_processes = _n_processes(n_jobs)
    if n_processes == 1:
        return (function(*call) for call in calls)
    with (
        _failures_reported(),
        joblib.parallel_config(
            "loky",
            n_jobs=n_processes,
            inner_max_num_threads=1,
            initializer=_prepare_process,
            initargs=(os.getpid(),),
        ),
    ):
        options |= {"return_as": "generator" if in_order else "generator_unordered"}
        options |= {"temp_folder": _start_processes(n_processes, options)}
        parallel = _Parallel(**options)
        _parallels.add(parallel)
        results = parallel(joblib.delayed(function)(*call) for call in calls)
    return _watched(results)


def stop_processes() -> None:
    """Stop the processes at once, whatever they are doing; results still to come are given up."""
    if joblib.effective_n_jobs(2) == 1:
        return
    for parallel in list(_parallels):
        parallel._abort()
    from joblib.externals.loky import get_reusable_executor

    get_reusable_executor(reuse=True).shutdown(wait=True, kill_workers=True)


@contextmanager
def one_blas_thread() -> Iterator[int]:
    """Keep BLAS to one thread, for results that do not depend on the number.

    Yields
    ------
    n_threads : int
        How many it was allowed before.
    """
    controller = _blas_controller()
    n_threads = max((library.num_threads for library in controller.lib_controllers), default=1)
    with controller.limit(limits=1):
        yield n_threads


@cache
def _blas_controller() -> ThreadpoolController:
    import scipy.linalg  # noqa: F401  its BLAS is another than NumPy's, and has to be seen too

    return ThreadpoolController().select(user_api="blas")


def _n_processes(n_jobs: int | None) -> int:
    """How many processes share the calls; one where the system lets nobody start more."""
    if n_jobs is None or n_jobs == 1:
        return 1
    n_processes: int = joblib.effective_n_jobs(n_jobs)
    if joblib.effective_n_jobs(2) == 1 and not _can_be_started():
        warnings.warn(
            "No processes can be started here, for want of semaphores (is /dev/shm there, and "
            "writable?): one does all, as with --jobs 1.",
            ServoscopeWarning,
            stacklevel=3,
        )
    return n_processes


@cache
def _can_be_started() -> bool:
    """Whether the system gives semaphores, which processes need to share calls."""
    try:
        from multiprocessing import get_context

        get_context("spawn").Semaphore()
    except (ImportError, OSError):
        return False
    return True


def _start_processes(n_processes: int, options: dict[str, Any]) -> str:
    """Start the processes, if they do not run yet; returns the folder in which they share arrays.

    They ignore Ctrl-C.
    """
    options = {**options, "pre_dispatch": "all", "batch_size": 1, "return_as": "generator"}
    try:
        folder = shared_folder()
        with _interrupts_ignored():
            parallel = joblib.Parallel(**options, temp_folder=folder)
            started = parallel([joblib.delayed(int)()] * n_processes)
        list(started)
        return folder
    except OSError as error:
        raise ProcessesError(
            f"Processes cannot be started ({error.strerror or error}); repeat with --jobs 1."
        ) from error


def _watched(results: Iterator[Any]) -> Iterator[Any]:
    """The results, while it is seen to that one killed process ends them all.

    joblib sees to that itself, but not while it reads a result: one of which a process had sent a
    part when it was killed would be waited for without end, and the others could send none.
    """
    from joblib.externals.loky import get_reusable_executor

    over = threading.Event()
    watch = threading.Thread(
        target=_end_when_one_did, args=(get_reusable_executor(reuse=True), over), daemon=True
    )
    watch.start()
    try:
        with _failures_reported():
            yield from results
    finally:
        over.set()


def _end_when_one_did(executor: Any, over: threading.Event) -> None:
    """Kill all processes of joblib's where one stays among them that has ended."""
    had_ended: set[Any] = set()
    while not over.wait(WATCH_INTERVAL):
        sentinels = [process.sentinel for process in list(executor._processes.values())]
        ended = set(wait(sentinels, timeout=0))
        if ended & had_ended:
            executor._executor_manager_thread.kill_workers()
            executor._result_queue._writer.close()  # the last end of the pipe: reading it ends
            return
        had_ended = ended


@contextmanager
def _failures_reported() -> Iterator[None]:
    """Say in a sentence that a process was killed, or why it failed."""
    try:
        yield
    except BrokenProcessPool as error:
        from joblib.externals.loky.process_executor import TerminatedWorkerError

        is_cut_short = "end of file during message" in str(error.__cause__)
        if not (isinstance(error, TerminatedWorkerError) or is_cut_short):
            raise ProcessesError(
                f"Processes failed ({one_line(error).rstrip('.')}); repeat with --jobs 1."
            ) from error
        raise ProcessKilledError(
            "A process was killed, most likely because memory ran out; repeat the command with "
            "fewer processes, such as --jobs 1, a run with --resume."
        ) from error


def _prepare_process(owner: int) -> None:
    """Leave Ctrl-C to the process that started this one, and end when that is gone.

    Where psutil is installed, joblib ends a process that has grown by 300 MB, since it might leak.
    Ours keep what they will need again.
    """
    from joblib.externals.loky import process_executor

    process_executor._USE_PSUTIL = False
    gc.set_threshold(700, 10, 100)  # imports provoke collections, a fifth of their time
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_after, args=(owner,), daemon=True).start()


def _end_after(owner: int) -> None:
    if sys.platform == "win32":
        from multiprocessing import parent_process

        parent = parent_process()
        if parent is not None:
            parent.join()
    else:
        while os.getppid() == owner:
            time.sleep(WATCH_INTERVAL)
    os._exit(1)


@contextmanager
def _interrupts_ignored() -> Iterator[None]:
    """Ignore Ctrl-C for a moment; processes that are started meanwhile ignore it for good."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
