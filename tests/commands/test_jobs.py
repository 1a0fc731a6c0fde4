"""Lists of jobs of which one fails, or kills its process."""

import os
import signal

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
    large, odd, last = list(outcomes(job, [(name, tries) for name in ("large", "odd", "b")], 2))
    assert last == "b"
    assert isinstance(odd, Failed)
    assert odd.reason == "unexpected ValueError: it is odd; --debug shows where it came from"
    assert "in job" in odd.traceback
    assert isinstance(large, Failed)
    assert large.reason.startswith("A process was killed")
    assert tries.read_text().split().count("large") >= 2
