"""Lists of jobs of which one fails, or kills its process."""

import os
import signal
import time
from contextlib import nullcontext
from operator import itemgetter

import pytest

from servoscope.cluster import on_cluster
from servoscope.commands.jobs import Failed, outcomes


def job(name, tries):
    with open(tries, "a") as file:
        file.write(f"{name} ")
    if name == "large":
        os.kill(os.getpid(), signal.SIGKILL)
    if name == "odd":
        raise ValueError("it is odd")
    return name


def test_a_job_that_fails_or_kills_its_process_has_its_reason_and_all_others_go_on(tmp_path):
    tries = tmp_path / "tries"
    made = outcomes(job, [(name, tries) for name in ("large", "odd", "b")], 2)
    large, odd, last = (outcome for _, outcome in sorted(made, key=itemgetter(0)))
    assert last == "b"
    assert isinstance(odd, Failed)
    assert odd.reason == "unexpected ValueError: it is odd; --debug shows where it came from"
    assert "in job" in odd.traceback
    assert isinstance(large, Failed)
    assert large.reason.startswith("A process was killed")
    assert tries.read_text().split().count("large") >= 2


def short_jobs_or_the_long_one(number, folder, n_short):
    """The long job, number 0, ends when all short ones have."""
    if number:
        (folder / str(number)).touch()
        return
    deadline = time.monotonic() + 60
    while len(list(folder.iterdir())) < n_short:
        assert time.monotonic() < deadline, "short jobs were kept waiting"
        time.sleep(0.01)


@pytest.mark.parametrize("n_workers", [None, 2])
def test_a_long_job_keeps_none_that_is_ready_waiting(n_workers, tmp_path):
    calls = [(number, tmp_path, 12) for number in range(13)]
    with nullcontext() if n_workers is None else on_cluster(n_workers=n_workers):
        made = dict(outcomes(short_jobs_or_the_long_one, calls, 2))
    assert made == dict.fromkeys(range(13))
