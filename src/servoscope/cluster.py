"""Calls shared among the workers of a dask cluster, here or elsewhere."""

from __future__ import annotations

import os
import signal
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from itertools import islice
from threading import Lock
from typing import Any
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from servoscope import __version__
from servoscope.errors import (
    InvalidInputError,
    ProcessesError,
    ProcessKilledError,
    ServoscopeWarning,
)
from servoscope.wording import one_line

_SENT_ONCE = 2**18
"""An array of more bytes is sent once for all pending calls that take it."""

_AHEAD = 3
"""Calls that wait at each worker's thread, so that none is idle."""

_CONNECT_S, _WATCH_S, _LOOK_S = 10.0, 30.0, 0.05
"""Seconds for a scheduler to answer, between looks whether it has workers, and which of several
calls has ended."""

_MOST_WORKERS = 16
"""For each core of this machine: more take its memory, and share its cores all the same."""

_ENDS = (signal.SIGINT, signal.SIGTERM)

_in_use: list[Cluster] = []


def current() -> Cluster | None:
    """The cluster that calls are shared with, None for processes of this machine."""
    return _in_use[-1] if _in_use else None


@contextmanager
def on_cluster(address: str | None = None, n_workers: int | None = None) -> Iterator[Cluster]:
    """Share calls with a cluster: one that runs, or workers that are started here.

    Whoever can reach a scheduler can run code on its workers: see that only those can who may, and
    use addresses that begin with ``tls://`` beyond one machine.

    Parameters
    ----------
    address : str, optional
        Of a scheduler, such as ``tcp://192.0.2.7:8786``.
    n_workers : int, optional
        How many to start here instead, of one thread each, reached from this machine alone.

    Raises
    ------
    InvalidInputError
        If neither or both are given.
    ProcessesError
        If dask.distributed is not installed, or the scheduler cannot be reached or has no workers.
    """
    if (address is None) == (n_workers is None):
        raise InvalidInputError("Give the address of a scheduler or a number of workers, not both.")
    if n_workers is not None and n_workers < 1:
        raise InvalidInputError(f"There must be 1 worker or more, got {n_workers}.")
    most = _MOST_WORKERS * (os.cpu_count() or 1)
    if n_workers is not None and n_workers > most:
        raise InvalidInputError(f"There are at most {most} workers on this machine, got more.")
    if address is not None and "@" in address:
        raise InvalidInputError(
            "The address of a scheduler has no user and no password; use certificates, and an "
            "address such as tls://192.0.2.7:8786."
        )
    stack = ExitStack()
    try:
        cluster = Cluster(_connected_or_refused(address, n_workers, stack))
        _in_use.append(cluster)
        stack.callback(_in_use.remove, cluster)
        yield cluster
    finally:
        with _ends_held():
            stack.close()


def _connected_or_refused(address: str | None, n_workers: int | None, stack: ExitStack) -> Any:
    """What `_connected` gives, or a `ProcessesError`."""
    try:
        return _connected(address, n_workers, stack)
    except ImportError as error:
        raise ProcessesError(
            'Sharing work with workers needs dask; install it: pip install "servoscope[dask]".'
        ) from error
    except (OSError, TypeError, ValueError, RuntimeError) as error:
        raise ProcessesError(
            f"No workers can be had {'here' if address is None else f'at {address}'} "
            f"({one_line(error)}); start a scheduler and workers (dask scheduler, dask "
            "worker), or use --workers."
        ) from error


@contextmanager
def _ends_held() -> Iterator[None]:
    """Let Ctrl-C and SIGTERM wait for the end of the block: dask is not half begun or half ended.

    Ctrl-C in a terminal goes to all processes that were started from there. Those that threads of
    the block ever start do not hear it.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    before = {number: signal.signal(number, lambda n, _: came.append(n)) for number in _ENDS}
    can_mask = hasattr(signal, "pthread_sigmask")
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}) if can_mask else set()
    try:
        yield
    finally:
        if can_mask:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for number, handler in before.items():
            signal.signal(number, handler)
        for came_first in came[:1]:
            signal.raise_signal(came_first)


def _connected(address: str | None, n_workers: int | None, stack: ExitStack) -> Any:
    """A client of a scheduler that has a worker; the stack closes what is begun."""
    from multiprocessing import resource_tracker

    import dask
    import distributed
    from distributed.gc import disable_gc_diagnosis
    from distributed.utils import LoopRunner, silence_logging_cmgr, sync

    settings: dict[str, float] = {"comm.timeouts.connect": _CONNECT_S}
    settings["admin.low-level-log-length"] = 0  # which would keep the arrays that were sent
    stack.enter_context(dask.config.set({f"distributed.{k}": v for k, v in settings.items()}))
    stack.enter_context(silence_logging_cmgr("CRITICAL"))  # importing dask sets its own levels
    scheduler: Any = None
    if address is not None:
        scheduler = address.rstrip("/")
        beside = LoopRunner()  # a notebook has an event loop of its own
        beside.start()
        stack.callback(beside.stop)
        sync(beside.loop, _check_scheduler, scheduler)
    resource_tracker.ensure_running()  # its first start lets the thread hear Ctrl-C
    with _ends_held():
        if n_workers is not None:
            scheduler = stack.enter_context(
                distributed.LocalCluster(
                    n_workers=n_workers,
                    threads_per_worker=1,
                    host="127.0.0.1",
                    dashboard_address="127.0.0.1:0",
                    silence_logs="CRITICAL",
                )
            )
        client = stack.enter_context(
            distributed.Client(scheduler, timeout=_CONNECT_S, set_as_default=False)
        )
    disable_gc_diagnosis(force=True)  # which swallows a Ctrl-C that comes within it
    client.wait_for_workers(1, timeout=_CONNECT_S)
    return client


async def _check_scheduler(address: str) -> None:
    """Raise an error of whatever kind unless a scheduler answers at an address.

    A client would wait for one that never answers, and one that cannot be made would end late and
    with a traceback.
    """
    from asyncio import timeout

    from distributed import Security, rpc

    keys = Security().get_connection_args("client")
    try:
        async with (
            timeout(_CONNECT_S),
            rpc(address, timeout=_CONNECT_S, connection_args=keys) as found,
        ):
            kind = (await found.identity())["type"]
    except TimeoutError as error:
        raise OSError(f"no scheduler answers within {_CONNECT_S:g} s") from error
    if kind != "Scheduler":
        raise ValueError(f"it is the address of a {kind}, not of a scheduler")


@dataclass(frozen=True, eq=False)
class _Sent:
    """An array at a worker, for as long as a call that takes it is pending.

    It is kept here as well, so that its id is its own.
    """

    array: NDArray[Any]
    future: Any


_AllSent = WeakValueDictionary[int, _Sent]
"""By the ids of the arrays; the pending calls keep them."""


@dataclass(frozen=True, eq=False)
class _Pending:
    """A call whose result is not there yet, and the large arrays that it takes."""

    call: tuple[Any, ...]
    future: Any
    arrays: list[_Sent]


class Cluster:
    """What shares calls with the workers of a scheduler.

    Parameters
    ----------
    client : distributed.Client
    """

    def __init__(self, client: Any) -> None:
        self.client = client

    def results(
        self,
        function: Callable[..., Any],
        calls: Iterable[tuple[Any, ...]],
        *,
        in_order: bool = True,
    ) -> Iterator[Any]:
        """What a function returns for each tuple of arguments, in their order or as it is ready.

        The first calls are sent at once. A worker that ends is replaced by another, which computes
        the same. Large arrays are sent once, and again where they are lost, and released with the
        last pending call that takes them.

        Raises
        ------
        ProcessesError
            If the scheduler is lost; a `ProcessKilledError` if a call ends worker after worker.
        """
        with _loss_reported():
            n_threads = max(1, sum(self.client.nthreads().values()))
        sent: _AllSent = WeakValueDictionary()
        left = iter(calls)

        def submitted(n: int) -> list[_Pending]:
            return [self._submit(function, call, sent) for call in islice(left, n)]

        return self._as_ready(submitted, submitted(_AHEAD * n_threads), in_order)

    def _as_ready(
        self,
        submitted: Callable[[int], list[_Pending]],
        pending: list[_Pending],
        in_order: bool,
    ) -> Iterator[Any]:
        try:
            while pending:
                ready = self._first_ready(pending[:1] if in_order else pending)
                result = self._result(ready)
                pending += submitted(1)
                pending.remove(ready)
                del ready  # with its arrays
                yield result
        finally:
            with suppress(Exception):
                self.client.cancel([call.future for call in pending])

    def _first_ready(self, pending: Sequence[_Pending]) -> _Pending:
        """The first of some calls that ends; it is said where no worker is left to make them."""
        is_said, watch = False, time.monotonic() + _WATCH_S
        with _loss_reported():
            while not (ended := [call for call in pending if call.future.done()]):
                with suppress(TimeoutError):
                    pending[0].future.exception(_WATCH_S if len(pending) == 1 else _LOOK_S)
                if time.monotonic() < watch or is_said:
                    continue
                watch += _WATCH_S
                if not (pending[0].future.done() or self.client.nthreads()):
                    is_said = True
                    warnings.warn(
                        "The scheduler has no workers left, and is waited for until it has one "
                        "(dask worker); Ctrl-C ends that, and a run goes on with --resume.",
                        ServoscopeWarning,
                        stacklevel=2,
                    )
        return ended[0]

    def _result(self, ready: _Pending) -> Any:
        with _loss_reported():
            if ready.future.status != "error":
                return ready.future.result()
            error = ready.future.exception().with_traceback(ready.future.traceback())
        raise _own_or_reported(error, ready.call)

    def _submit(
        self, function: Callable[..., Any], call: tuple[Any, ...], sent: _AllSent
    ) -> _Pending:
        arrays: list[_Sent] = []
        with _loss_reported():
            arguments = self._sent(call, sent, arrays)
            future = self.client.submit(_run, __version__, function, arguments, pure=False)
        return _Pending(call, future, arrays)

    def _sent(self, argument: Any, sent: _AllSent, arrays: list[_Sent]) -> Any:
        """An argument, or what stands for a large array, at any depth of tuples."""
        if type(argument) is tuple:
            return tuple(self._sent(part, sent, arrays) for part in argument)
        if not isinstance(argument, np.ndarray) or argument.nbytes <= _SENT_ONCE:
            return argument
        one = sent.get(id(argument))
        if one is None:
            one = _Sent(argument, self.client.submit(_given, argument, pure=False))
            sent[id(argument)] = one
        arrays.append(one)
        return one.future


@contextmanager
def _loss_reported() -> Iterator[None]:
    """Say in a sentence that the scheduler is lost, around nothing but what asks it."""
    from concurrent.futures import CancelledError

    try:
        yield
    except (CancelledError, OSError) as error:  # as are those of dask's connections
        raise ProcessesError(
            f"The scheduler is lost ({one_line(error)}); start it and "
            "its workers, and repeat the command, a run with --resume."
        ) from error


def _own_or_reported(error: BaseException, call: tuple[Any, ...]) -> BaseException:
    """The error that a call ended with: its own as it is, those of dask in a sentence."""
    from distributed import KilledWorker

    if isinstance(error, KilledWorker):
        reported: ProcessesError = ProcessKilledError(
            "Worker after worker ended in one call, most likely because memory ran out; give "
            "each more memory, or repeat with fewer, a run with --resume.",
            call,
        )
    elif isinstance(error, RuntimeError) and "deserialization of the task graph" in str(error):
        reported = ProcessesError(
            f"Scheduler or workers cannot take a call ({one_line(error.__cause__ or error)}); "
            "all must have the same version of servoscope, and its plug-ins."
        )
    else:
        return error
    reported.__cause__ = error
    return reported


def _given(argument: Any) -> Any:
    return argument


_ONE_AT_A_TIME = Lock()
"""Warnings that a call records, and the threads of BLAS, are of the whole process."""


def _run(version: str, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
    """A call at a worker, which has one BLAS thread, and makes no other meanwhile."""
    if version != __version__:
        raise ProcessesError(
            f"A worker has servoscope {__version__} and this machine {version}, which may find "
            "other figures; install the same everywhere."
        )
    with _ONE_AT_A_TIME, threadpool_limits(1, user_api="blas"):
        return function(*arguments)
