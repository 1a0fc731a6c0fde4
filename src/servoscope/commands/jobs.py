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
) -> Iterator[Any]:
    """What a function returns for each tuple of arguments, or a `Failed`, in their order.

    Where a process is killed, the call that is waited for is tried once more by itself: if it ends
    its process again it has failed, and all others go on.
    """
    left = [(function, *call) for call in calls]
    while left:
        try:
            for outcome in in_processes(_outcome, left.copy(), n_jobs, batch_size=1):
                del left[0]
                yield outcome
        except ProcessKilledError:
            try:
                (outcome,) = in_processes(_outcome, left[:1], n_jobs, batch_size=1)
            except ProcessKilledError as error:
                outcome = Failed.by(error)
            del left[0]
            yield outcome


def _outcome(function: Callable[..., Any], *call: Any) -> Any:
    try:
        return function(*call)
    except Exception as error:  # one job is not the end of all
        return Failed.by(error)


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
        first = next(iter(failed))
        raise kind(
            f"{len(failed)} of {what}, such as {first}; mend what {page} says, and repeat the "
            "command with --resume."
        ) from _Tracebacks(failed)


class _Tracebacks(Exception):
    """Where jobs have failed, which --debug shows."""

    def __init__(self, failed: Mapping[str, Failed]) -> None:
        super().__init__("".join(f"\n\n{name}: {one.traceback}" for name, one in failed.items()))
