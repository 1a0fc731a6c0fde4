"""Progress bars on the terminal."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)


@contextmanager
def progress_bar(description: str, total: int | None) -> Iterator[Callable[[int], object]]:
    """A bar on standard error; yields the function that is told how many items are done.

    Where standard error is not a terminal, one line says what is being done instead, once it has
    begun.
    """
    console = Console(stderr=True)
    if not console.is_terminal:
        yield _announcement(description if total is None else f"{description} ({total})")
        return
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console) as progress:
        task = progress.add_task(description, total=total)
        yield lambda n_done: progress.update(task, completed=n_done)


def _announcement(description: str) -> Callable[[int], object]:
    """What says once that something has begun."""
    announced = False

    def advance(n_done: int) -> None:
        nonlocal announced
        if not announced:
            print(f"{description} ...", file=sys.stderr)
        announced = True

    return advance
