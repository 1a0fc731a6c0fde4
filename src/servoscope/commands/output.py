"""What commands print on standard output."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.table import Table


def console() -> Console:
    """Standard output, wide enough for tables also where it is not a terminal."""
    width = None if sys.stdout.isatty() else max(120, shutil.get_terminal_size().columns)
    return Console(width=width, highlight=False, markup=False)


def print_json(value: Any) -> None:
    """Print one JSON value."""
    print(json.dumps(value, indent=1, allow_nan=False))


def print_facts(facts: Mapping[str, Any], *, as_json: bool = False) -> None:
    """Print names and values, as two columns or as JSON."""
    if as_json:
        print_json(facts)
        return
    table = Table(box=None, show_header=False, pad_edge=False)
    for name, value in facts.items():
        table.add_row(name.replace("_", " "), _shown(value))
    console().print(table)


def _shown(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{_shown(key)} {_shown(item)}" for key, item in value.items()) or "-"
    if isinstance(value, list | tuple):
        of_parts = any(isinstance(item, Mapping) for item in value)
        return ("; " if of_parts else " x ").join(map(_shown, value))
    if isinstance(value, float):
        return f"{value:.4g}"
    return "".join(c if c.isprintable() else "?" for c in str(value))
