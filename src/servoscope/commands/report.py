"""``servoscope report``."""

from __future__ import annotations

from servoscope.commands.options import Jobs, Json, Run


def report(run: Run, jobs: Jobs = None, json: Json = False) -> None:
    """Write the report of a finished run again.

    Example: servoscope report servoscope-study
    """
    from servoscope.commands.options import n_jobs
    from servoscope.commands.output import print_facts
    from servoscope.storage.folders import owned
    from servoscope.storage.run_folder import read_settings
    from servoscope.study.page import write_report

    processes = n_jobs(jobs)
    read_settings(run)  # what is no run folder gets no lock
    with owned(run):
        page = write_report(run, n_jobs=processes)
    print_facts({"report": str(page)}, as_json=json)
