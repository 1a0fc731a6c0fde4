"""A list of jobs of which one that fails is not the end of all: it has its reason."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from servoscope.commands.streams import reason_of
from servoscope.errors import ProcessKilledError, ServoscopeError
from servoscope.processes import in_processes


@dataclass(frozen=True)
class Failed:
    """Why a job failed, on one line, and where, as a text: processes share no tracebacks."""

    reason: str
    traceback: str

    @classmethod
    def by(cls, error: Exception) -> Failed:
        """What is kept of an error."""
        return cls(reason_of(error), "".join(traceback.format_exception(error)))


def outcomes(
    function: Callable[..., Any], calls: Sequence[tuple[Any, ...]], n_jobs: int
) -> Iterator[tuple[int, Any]]:
    """The number of each tuple of arguments, and what a function returns for it, or a `Failed`:
    those that are ready first come first, so that none is lost while a longer one is waited for.

    Where a process is killed, the call that it was in, or else the first that is left, is tried
    once more by itself: if it ends its process again it has failed, and all others go on.
    """
    left = {number: (number, function, *call) for number, call in enumerate(calls)}
    options: dict[str, Any] = {"in_order": False, "batch_size": 1}
    while left:
        try:
            for number, outcome in in_processes(_outcome, [*left.values()], n_jobs, **options):
                del left[number]
                yield number, outcome
        except ProcessKilledError as error:
            number = error.call[0] if error.call else next(iter(left))
            try:
                ((_, outcome),) = in_processes(_outcome, [left[number]], n_jobs, **options)
            except ProcessKilledError as again:
                outcome = Failed.by(again)
            del left[number]
            yield number, outcome


def _outcome(number: int, function: Callable[..., Any], *call: Any) -> tuple[int, Any]:
    try:
        return number, function(*call)
    except Exception as error:  # one job is not the end of all
        return number, Failed.by(error)


def check_failed(
    failed: Mapping[str, Failed], what: str, page: Path, kind: type[ServoscopeError]
) -> None:
    """Raise an error of a kind if jobs have failed: how many, and where the reasons are.

    Parameters
    ----------
    failed : dict
        Those that have, by name.
    what : str
        How many there were, and what could not be done with them.
    page : Path
        It has the reasons.
    """
    if failed:
        failed = dict(sorted(failed.items()))  # whichever ended first
        first = next(iter(failed))
        raise kind(
            f"{len(failed)} of {what}, such as {first}; mend what {page} says, and repeat the "
            "command with --resume."
        ) from _Tracebacks(failed)


class _Tracebacks(Exception):
    """Where jobs have failed, which --debug shows."""

    def __init__(self, failed: Mapping[str, Failed]) -> None:
        super().__init__("".join(f"\n\n{name}: {one.traceback}" for name, one in failed.items()))
