"""What commands print: data on standard output, the rest and progress bars on standard error."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from rich.console import Console, ConsoleOptions, RenderableType
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.segment import Segment
from rich.table import Table

from servoscope.commands.streams import print_message
from servoscope.errors import InvalidInputError
from servoscope.storage.folders import to_json
from servoscope.wording import printable

_EVERY_S = 60.0
"""How often it is said how far something is, where there is no terminal, [s]."""


class SafeConsole(Console):
    """A console on which no text moves the cursor or changes the terminal."""

    def render(
        self, renderable: RenderableType, options: ConsoleOptions | None = None
    ) -> Iterable[Segment]:
        """The segments of a text or a table, as of `Console`, but printable."""
        for segment in super().render(renderable, options):
            text = segment.text if segment.control else printable(segment.text)
            yield Segment(text, segment.style, segment.control)


def console() -> Console:
    """Standard output, wide enough for tables also where it is not a terminal."""
    width = None if sys.stdout.isatty() else max(120, shutil.get_terminal_size().columns)
    return SafeConsole(width=width, highlight=False, markup=False)


def print_json(value: Any) -> None:
    """Print one JSON value."""
    print(to_json(value).replace("\x7f", "\\u007f"))


def print_facts(facts: Mapping[str, Any], *, as_json: bool = False) -> None:
    """Print names and values, as two columns or as JSON."""
    if as_json:
        print_json(facts)
        return
    table = Table(box=None, show_header=False, pad_edge=False)
    for name, value in facts.items():
        table.add_row(name.replace("_", " "), _shown(value))
    console().print(table)


def confirmed(question: str, yes: bool) -> bool:
    """Whether a person agrees, or has agreed before by ``--yes``.

    Raises
    ------
    InvalidInputError
        If there is nobody to be asked.
    """
    if yes:
        return True
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        raise InvalidInputError(f"{question} Nobody can be asked here; agree with --yes.")
    print_message(f"{question} [y/N]")
    return sys.stdin.readline().strip().lower() in ("y", "yes")


def _shown(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{_shown(key)} {_shown(item)}" for key, item in value.items()) or "-"
    if isinstance(value, list | tuple):
        if all(isinstance(item, str) for item in value):
            return " ".join(map(_shown, value)) or "none"
        of_parts = any(isinstance(item, Mapping) for item in value)
        return ("; " if of_parts else " x ").join(map(_shown, value))
    if isinstance(value, float):
        return f"{value:.4g}"
    return printable(str(value)).replace("\n", "?")


@contextmanager
def progress_bar(description: str, total: int | None) -> Iterator[Callable[[int], object]]:
    """A bar on standard error; yields the function that takes how many items are done.

    Where standard error is not a terminal, one line says what is being done instead, once it has
    begun, and another every minute how far it is.
    """
    console = SafeConsole(stderr=True)
    if not console.is_terminal:
        yield _announcement(description, total)
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


def _announcement(description: str, total: int | None) -> Callable[[int], object]:
    """What says that something has begun, and now and then how far it is and how long it takes."""
    begun = said = time.monotonic()
    announced, first = False, 0

    def advance(n_done: int) -> None:
        nonlocal announced, first, begun, said
        now = time.monotonic()
        if not announced:
            print_message(f"{description if total is None else f'{description} ({total})'} ...")
            announced, first, begun, said = True, n_done, now, now
        elif now - said >= _EVERY_S:
            said, left = now, ""
            if total is not None and n_done > first:
                seconds = (now - begun) * (total - n_done) / (n_done - first)
                left = f" of {total}, about {max(1, round(seconds / 60))} min left"
            print_message(f"{description}: {n_done}{left}")

    return advance
