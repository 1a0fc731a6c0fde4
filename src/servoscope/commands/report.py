"""``servoscope report``."""

from __future__ import annotations

from servoscope.commands.options import Jobs, Json, Run


def report(run: Run, jobs: Jobs = None, json: Json = False) -> None:
    """Write the report of a finished run again.

    Example: servoscope report servoscope-study
    """
    from servoscope.commands.options import n_jobs
    from servoscope.commands.output import print_facts
    from servoscope.report import write_report

    print_facts({"report": str(write_report(run, n_jobs=n_jobs(jobs)))}, as_json=json)
