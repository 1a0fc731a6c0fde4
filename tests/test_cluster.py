"""Calls shared with real dask workers: the same results, whatever happens to a worker."""

import gc
import importlib
import io
import logging
import os
import signal
import socket
import subprocess
import sys
import threading
import time
import weakref
from concurrent.futures import CancelledError
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("distributed")

from servoscope.cluster import _ends_held, current, on_cluster
from servoscope.errors import InvalidInputError, ProcessesError, ServoscopeWarning
from servoscope.processes import in_processes

pytestmark = [
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]


WORKER_MEMORY = 700 * 10**6
"""Of the worker of `scheduler`, [bytes]."""


def scaled(X, factor, parts=()):
    return os.getpid(), factor * X.sum() + sum(part.sum() for part in parts)


def killed_once(place, i):
    """The second call kills its worker, the first time."""
    mark = place / "killed"
    if i == 1 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return i * i


def too_large_once(place, i):
    """The second call takes more memory than its worker may, the first time."""
    mark = place / "too large"
    if i == 1 and not mark.exists():
        mark.touch()
        _take(2 * WORKER_MEMORY)
    return i * i


def too_large(i):
    _take(2 * WORKER_MEMORY)


def _take(n_bytes):
    """Fill memory bit by bit, and keep it until the process is ended; nobody waits longer."""
    taken = []
    for _ in range(20):
        taken.append(np.ones(n_bytes // 20, np.uint8))
        time.sleep(0.02)
    time.sleep(30)


def always_killed(i):
    os.kill(os.getpid(), signal.SIGKILL)


def fails(kind):
    raise kind("of the call")


@pytest.fixture(scope="module")
def cluster():
    with on_cluster(n_workers=2) as found:
        yield found


def test_workers_return_what_one_process_does_in_the_order_of_the_calls(cluster):
    X = np.random.default_rng(0).normal(size=(300, 300))
    calls = [(X, factor, (X, X[:2])) for factor in range(20)]
    assert current() is cluster
    shared = list(in_processes(scaled, calls))
    alone = list(in_processes(scaled, calls, 1))
    assert [value for _, value in shared] == [value for _, value in alone]
    pids = {pid for pid, _ in shared}
    assert os.getpid() not in pids
    assert len(pids) == 2


def test_a_large_array_is_kept_no_longer_than_a_call_that_takes_it_is_pending(cluster, monkeypatch):
    shared, own, n_sent = np.ones(40_000), [], []
    submit = cluster.client.submit

    def counted(function, *arguments, **options):
        n_sent.append(function.__name__)
        return submit(function, *arguments, **options)

    def calls():
        for i in range(40):
            array = np.full(40_000, float(i))
            own.append(weakref.ref(array))
            yield array, 1.0, (shared,)

    monkeypatch.setattr(cluster.client, "submit", counted)
    n_kept = []
    for i, (_, total) in enumerate(in_processes(scaled, calls())):
        assert total == 40_000 * (i + 1)
        n_kept.append(sum(ref() is not None for ref in own))
    assert max(n_kept) <= 12  # of 6 calls that are pending, and some that are on their way
    assert n_sent.count("_given") == 41
    assert not cluster.client.futures


@pytest.mark.parametrize(
    "kind",
    [InvalidInputError, TimeoutError, ConnectionError, OSError, CancelledError, RuntimeError],
)
def test_the_error_of_a_call_is_raised_as_it_is_whatever_dask_itself_raises(cluster, kind):
    with pytest.raises(kind, match="of the call") as caught:
        list(in_processes(fails, [(kind,), (ValueError,)]))
    assert type(caught.value) is kind
    assert caught.traceback[-1].name == "fails"


def test_the_error_of_what_makes_the_calls_is_raised_as_it_is(cluster):
    def calls():
        for number in range(10):
            yield number, 2
        raise TimeoutError("of the camera")

    with pytest.raises(TimeoutError, match="of the camera"):
        list(in_processes(divmod, calls()))


within = []


def alone(i):
    """Whether no other call is made by this process meanwhile."""
    within.append(i)
    time.sleep(0.05)
    is_alone = within == [i]
    within.remove(i)
    return is_alone


@pytest.fixture
def threads():
    """A scheduler with a worker of four threads, in this process."""
    distributed = importlib.import_module("distributed")
    options = {"processes": False, "dashboard_address": None, "silence_logs": "CRITICAL"}
    with distributed.LocalCluster(n_workers=1, threads_per_worker=4, **options) as found:
        yield found


def test_a_worker_of_several_threads_makes_one_call_at_a_time(threads):
    with on_cluster(threads.scheduler_address):
        assert all(in_processes(alone, [(i,) for i in range(8)]))


def test_that_no_worker_is_left_is_said_and_the_next_one_goes_on(threads, monkeypatch):
    monkeypatch.setattr("servoscope.cluster._WATCH_S", 0.1)
    with on_cluster(threads.scheduler_address) as cluster:
        threads.scale(0)
        while cluster.client.nthreads():
            time.sleep(0.02)
        results = in_processes(divmod, [(7, 2)])
        later = threading.Timer(0.5, threads.scale, (1,))
        later.start()
        with pytest.warns(ServoscopeWarning, match="no workers left"):
            assert list(results) == [(3, 1)]
        later.join()


def test_a_killed_worker_changes_no_result(cluster, tmp_path):
    calls = [(tmp_path, i) for i in range(12)]
    assert list(in_processes(killed_once, calls)) == [i * i for i in range(12)]
    assert (tmp_path / "killed").exists()


def test_workers_of_another_version_are_refused(cluster, monkeypatch):
    monkeypatch.setattr("servoscope.cluster.__version__", "0.0.1")
    with pytest.raises(ProcessesError, match=r"this machine 0\.0\.1, .* install the same"):
        list(in_processes(abs, [(1,)]))


def test_ctrl_c_in_a_terminal_is_heard_by_the_command_alone(tmp_path):
    """Nor is it by a worker that was started in place of another."""
    code = (
        "import test_cluster, time\n"
        "from pathlib import Path\n"
        "from servoscope.cluster import on_cluster\n"
        "from servoscope.processes import in_processes\n"
        "if __name__ == '__main__':\n"
        "    try:\n"
        "        with on_cluster(n_workers=1):\n"
        f"            place = Path({str(tmp_path)!r})\n"
        "            list(in_processes(test_cluster.killed_once, [(place, 0), (place, 1)]))\n"
        "            print('replaced', flush=True)\n"
        "            time.sleep(30)\n"
        "    except KeyboardInterrupt:\n"
        "        print('interrupted')\n"
    )
    (tmp_path / "command.py").write_text(code)
    process = subprocess.Popen(
        [sys.executable, "-Wignore", str(tmp_path / "command.py")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parent)},
    )
    assert process.stdout.readline() == "replaced\n"
    os.killpg(process.pid, signal.SIGINT)
    assert process.communicate(timeout=20) == ("interrupted\n", "")


def begun(steps):
    with _ends_held():
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.01)
        steps.append("whole")


def test_ctrl_c_waits_until_workers_are_started():
    steps = []
    with pytest.raises(KeyboardInterrupt):
        begun(steps)
    assert steps == ["whole"]


def test_what_kills_every_worker_ends_in_one_line():
    with on_cluster(n_workers=1) as cluster:
        cluster.client.run_on_scheduler(_allow_no_failure)
        with pytest.raises(ProcessesError, match=r"Worker after .* --resume") as caught:
            list(in_processes(always_killed, [(0,)]))
    assert "\n" not in str(caught.value)


def _allow_no_failure(dask_scheduler):
    dask_scheduler.allowed_failures = 0


@pytest.fixture
def scheduler(tmp_path):
    """A scheduler with a worker in a process group of its own, and its address."""
    code = (
        "import distributed, time\n"
        "if __name__ == '__main__':\n"
        "    c = distributed.LocalCluster(n_workers=1, threads_per_worker=1, host='127.0.0.1',"
        f" dashboard_address='127.0.0.1:0', memory_limit={WORKER_MEMORY})\n"
        "    print(c.scheduler_address, flush=True)\n"
        "    time.sleep(60)\n"
    )
    (tmp_path / "scheduler.py").write_text(code)
    process = subprocess.Popen(
        [sys.executable, str(tmp_path / "scheduler.py")],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        start_new_session=True,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])},  # calls are of this file
    )
    with process:
        yield process, process.stdout.readline().strip()
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)


@pytest.fixture
def log_of_dask():
    """What dask logs to be seen."""
    seen = io.StringIO()
    handler, logger = logging.StreamHandler(seen), logging.getLogger("distributed")
    logger.addHandler(handler)
    yield seen
    logger.removeHandler(handler)


def test_a_lost_scheduler_ends_in_one_line(scheduler, log_of_dask):
    process, address = scheduler
    with on_cluster(f"{address}/"):
        results = in_processes(time.sleep, [(0.3,)] * 100)
        assert next(results) is None
        os.killpg(process.pid, signal.SIGKILL)
        with pytest.raises(ProcessesError, match=r"scheduler is lost .* --resume"):
            list(results)
    assert not log_of_dask.getvalue()


def test_a_worker_out_of_memory_is_replaced_and_changes_no_result(scheduler, tmp_path):
    with on_cluster(scheduler[1]):
        calls = [(tmp_path, i) for i in range(6)]
        assert list(in_processes(too_large_once, calls)) == [i * i for i in range(6)]
    assert (tmp_path / "too large").exists()


def test_what_no_worker_has_memory_for_ends_in_one_line(scheduler):
    with on_cluster(scheduler[1]) as cluster:
        cluster.client.run_on_scheduler(_allow_no_failure)
        with pytest.raises(ProcessesError, match="memory ran out") as caught:
            list(in_processes(too_large, [(0,)]))
    assert "\n" not in str(caught.value)


def test_workers_that_lack_a_module_are_named_in_one_line(scheduler, tmp_path, monkeypatch):
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "only_here.py").write_text("def double(x):\n    return 2 * x\n")
    monkeypatch.syspath_prepend(str(tmp_path / "own"))
    double = importlib.import_module("only_here").double
    refused = pytest.raises(ProcessesError, match="same version of servoscope")
    with on_cluster(scheduler[1]), refused as caught:
        list(in_processes(double, [(1,)]))
    assert "only_here" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("address", "why"),
    [
        ("tcp://127.0.0.1:1", "no scheduler answers"),
        ("192.0.2.7", "missing port"),
        ("http://127.0.0.1:8786", "unknown address scheme"),
        ("tls://127.0.0.1:8786", "TLS"),
    ],
)
def test_an_address_without_a_scheduler_is_refused_in_one_line(address, why, monkeypatch):
    refused(address, why, monkeypatch)


def test_what_listens_but_is_no_scheduler_is_refused_in_time(monkeypatch):
    with socket.create_server(("127.0.0.1", 0)) as silent:
        port = silent.getsockname()[1]
        refused(f"tcp://127.0.0.1:{port}", "no scheduler answers", monkeypatch)


def test_the_address_of_a_worker_is_refused(cluster, monkeypatch):
    worker = next(iter(cluster.client.nthreads()))
    refused(worker, "of a Worker, not of a scheduler", monkeypatch)


def refused(address, why, monkeypatch):
    """No client is left that ends seconds later with a traceback."""
    monkeypatch.setattr("servoscope.cluster._CONNECT_S", 1.0)
    start = time.monotonic()
    with pytest.raises(ProcessesError, match=why) as caught, on_cluster(address):
        pass
    assert str(caught.value).startswith(f"No workers can be had at {address} (")
    assert "\n" not in str(caught.value)
    gc.collect()
    assert time.monotonic() - start < 10  # dask closes one that could not connect in 20 s


def test_either_an_address_or_a_number_of_workers_is_given():
    with pytest.raises(InvalidInputError, match="not both"), on_cluster("tcp://127.0.0.1:1", 2):
        pass


@pytest.mark.parametrize(
    ("address", "n_workers", "words"),
    [
        ("tcp://somebody:secret@127.0.0.1:1", None, "no user and no password"),
        (None, 10**9, r"at most \d+ workers on this machine"),
        (None, 0, "1 worker or more"),
    ],
)
def test_what_no_workers_can_be_had_by_is_refused(address, n_workers, words):
    asked = on_cluster(address, n_workers)
    with pytest.raises(InvalidInputError, match=words) as caught, asked:
        pass
    assert "secret" not in str(caught.value)
