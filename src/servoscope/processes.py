"""Calls shared among processes, and BLAS kept to one thread."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import joblib
from threadpoolctl import ThreadpoolController


def in_processes(
    function: Callable[..., Any],
    calls: Iterable[tuple[Any, ...]],
    n_jobs: int | None = -1,
    **options: Any,
) -> Iterator[Any]:
    """What `function` returns for each tuple of arguments, in their order, as they are ready.

    The processes have one BLAS thread each, and leave Ctrl-C to this one.

    Parameters
    ----------
    function : callable
    calls : iterable of tuple
        The arguments of each call.
    n_jobs : int, optional
        Processes, as joblib counts them: -1 for all cores, 1 or None for this process alone.
    **options
        Of `joblib.Parallel`.

    Examples
    --------
    >>> list(in_processes(divmod, [(7, 2), (9, 4)], n_jobs=1))
    [(3, 1), (2, 1)]
    """
    with joblib.parallel_config("loky", n_jobs=n_jobs, inner_max_num_threads=1):
        parallel = joblib.Parallel(return_as="generator", **options)
        _start_processes(joblib.effective_n_jobs(n_jobs), options)
    results: Iterator[Any] = parallel(joblib.delayed(function)(*call) for call in calls)
    return results


def stop_processes() -> None:
    """Stop the processes at once, whatever they are doing."""
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


def _start_processes(n_processes: int, options: dict[str, Any]) -> None:
    """Start the processes, if they do not run yet, in such a way that they ignore Ctrl-C."""
    if n_processes == 1:
        return
    options = {**options, "pre_dispatch": "all", "batch_size": 1, "return_as": "generator"}
    with _interrupts_ignored():
        started = joblib.Parallel(**options)([joblib.delayed(int)()] * n_processes)
    list(started)


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
