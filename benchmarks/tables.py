"""Timings as text for a terminal and as Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.timing import Table, Timing

HEADER = ("tool", "wall s", "CPU s", "ratio", "remark")


@dataclass(frozen=True)
class Findings:
    """A table of something else than times."""

    title: str
    job: str
    header: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]


def as_text(table: Table | Findings) -> str:
    """The table in columns of equal width."""
    rows = _rows(table)
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)) for row in rows]
    return "\n".join([f"{table.title}: {table.job}", *(line.rstrip() for line in lines)])


def as_markdown(table: Table | Findings) -> str:
    """The table under a heading of the second level."""
    header, *rows = _rows(table)
    lines = [f"| {' | '.join(row)} |" for row in (header, ("---",) * len(header), *rows)]
    return "\n".join([f"## {table.title}", "", f"{table.job}.", "", *lines])


def as_page(machine: Mapping[str, str], tables: Sequence[Table | Findings], command: str) -> str:
    """A whole page of Markdown."""
    head = [
        "# Benchmarks",
        "",
        f"Written by `{command}`. Every table is one run on one set of data: the tools take turns, "
        "and the medians are shown. The ratio is that of processor time to ours; wall time also "
        'tells who uses several threads. "est" is scaled up from a part of the work.',
        "",
        *(f"- {topic}: {text}" for topic, text in machine.items()),
    ]
    targets = Path(__file__).with_name("targets.md").read_text(encoding="utf-8")
    return "\n\n".join(["\n".join(head), *map(as_markdown, tables), targets])


def _rows(table: Table | Findings) -> list[tuple[str, ...]]:
    """The header and what stands under it."""
    if isinstance(table, Findings):
        return [table.header, *table.rows]
    timings = [
        (
            timing.name,
            _seconds(timing.wall, timing),
            _seconds(timing.cpu, timing),
            _figures(table.ratio(timing)),
            timing.remark,
        )
        for timing in table.timings
    ]
    return [HEADER, *timings]


def _seconds(seconds: float | None, timing: Timing) -> str:
    return f"{_figures(seconds)}{' est' if timing.estimated else ''}"


def _figures(value: float | None) -> str:
    if value is None:
        return ""
    return f"{value:.3g}" if value < 1000 else f"{value:,.0f}"
