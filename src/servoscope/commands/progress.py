"""Progress bars on the terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from servoscope.commands.output import SafeConsole, print_message


@contextmanager
def progress_bar(description: str, total: int | None) -> Iterator[Callable[[int], object]]:
    """A bar on standard error; yields the function that takes how many items are done.

    Where standard error is not a terminal, one line says what is being done instead, once it has
    begun.
    """
    console = SafeConsole(stderr=True)
    if not console.is_terminal:
        yield _announcement(description if total is None else f"{description} ({total})")
        return
    columns = (
        TextColumn("{task.description}", markup=False),
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
            print_message(f"{description} ...")
        announced = True

    return advance
