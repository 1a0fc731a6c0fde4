"""What commands print: data on standard output, the rest on standard error."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Iterable, Mapping
from typing import Any

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.table import Table

from servoscope.wording import one_line, printable

_LONGEST_MESSAGE = 10_000


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
    print(json.dumps(value, indent=1, allow_nan=False).replace("\x7f", "\\u007f"))


def print_facts(facts: Mapping[str, Any], *, as_json: bool = False) -> None:
    """Print names and values, as two columns or as JSON."""
    if as_json:
        print_json(facts)
        return
    table = Table(box=None, show_header=False, pad_edge=False)
    for name, value in facts.items():
        table.add_row(name.replace("_", " "), _shown(value))
    console().print(table)


def print_message(message: str) -> None:
    """Print a line on standard error."""
    print(one_line(message, _LONGEST_MESSAGE), file=sys.stderr)


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
