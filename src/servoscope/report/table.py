"""One table, shown on a terminal, on a page, in Markdown, in LaTeX and as CSV."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

from markupsafe import Markup

from servoscope.storage.folders import write_text

NONE = "–"
"""Shown where there is no value."""

BOLD = ("best", "missed")
"""The marks of cells that are bold where there are no styles of a page."""


@dataclass(frozen=True)
class Cell:
    """A cell of a table.

    By its value, or else its text, the rows of a page are sorted; marks are classes of the page's
    style sheet, such as ``"best"``; `beside` and `below` are in small print after the text, and on
    a line under it; `link` is where the text leads from a page.
    """

    text: str
    value: float | None = None
    mark: str = ""
    beside: str = ""
    below: str = ""
    link: str = ""

    @property
    def is_bold(self) -> bool:
        """Whether it stands out."""
        return bool(set(self.mark.split()) & set(BOLD))

    @property
    def lines(self) -> list[str]:
        """All that it says."""
        first = " ".join(part for part in (self.text, self.beside) if part)
        return [*first.split("\n"), *([self.below] if self.below else [])]


@dataclass(frozen=True)
class Table:
    """A table in words, which knows nothing of what it is about.

    Parameters
    ----------
    columns : sequence of str
        The heads.
    rows : sequence of sequences of str or Cell
    title, caption : str
        The name of the table, and what has to be known to read it.
    align : str
        ``l`` or ``r`` for each column; the last holds for all that follow.
    name : str
        Of its place on a page.
    style : str
        Classes of the page's style sheet; rows of ``"sortable"`` tables can be sorted there.
    n_apart : int
        So many of the last rows are set apart from those above.

    Examples
    --------
    >>> table = Table(["dof", "RMS"], [["tx", Cell("0.5 mm", mark="best", beside="(0.7)")]])
    >>> print(table.to_markdown())
    | dof | RMS |
    | :-- | --: |
    | tx | **0.5 mm** (0.7) |
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[str | Cell]]
    title: str = ""
    caption: str = ""
    align: str = "lr"
    name: str = ""
    style: str = ""
    n_apart: int = 0

    def to_markdown(self) -> str:
        """The table as Markdown, its title above it."""
        heads = [":--" if self._is_left(k) else "--:" for k in range(len(self.columns))]
        lines = [f"**{self.title}**", ""] * bool(self.title)
        lines += [_row(map(_markdown, self.columns)), _row(heads)]
        for row in self._cells():
            lines.append(_row(_emphasised(cell, _markdown, "**{}**", "<br>") for cell in row))
        return "\n".join(lines)

    def to_csv(self) -> str:
        """The heads and the rows with commas between; numbers as they are, not as they are shown.

        Examples
        --------
        >>> print(Table(["dof", "RMS"], [["tx", Cell("0.5 mm", 0.4987)]]).to_csv(), end="")
        dof,RMS
        tx,0.4987
        """
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(self.columns)
        for row in self._cells():
            writer.writerow(
                " ".join(cell.lines) if cell.value is None else cell.value for cell in row
            )
        return text.getvalue()

    def to_latex(self) -> str:
        """The table as LaTeX, for the package booktabs."""
        align = "".join("l" if self._is_left(k) else "r" for k in range(len(self.columns)))
        lines = [r"\begin{table}", r"\centering"]
        if words := ". ".join(part for part in (self.title, self.caption) if part):
            lines.append(rf"\caption{{{_latex(words)}}}")
        lines += [rf"\begin{{tabular}}{{{align}}}", r"\toprule"]
        lines += [" & ".join(map(_latex, self.columns)) + r" \\", r"\midrule"]
        for number, row in enumerate(self._cells()):
            lines += [r"\midrule"] * (0 < self.n_apart == len(self.rows) - number)
            cells = []
            for k, cell in enumerate(row):
                text = _emphasised(cell, _latex, r"\textbf{{{}}}", r" \\ ")
                side = "l" if self._is_left(k) else "r"
                cells.append(rf"\shortstack[{side}]{{{text}}}" if r" \\ " in text else text)
            lines.append(" & ".join(cells) + r" \\")
        return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", r"\end{table}"])

    def to_html(self) -> str:
        """The table as part of a page."""
        words = [f"<b>{escape(self.title)}.</b>"] * bool(self.title) + [escape(self.caption)]
        named = f' id="{escape(self.name)}"' if self.name else ""
        heads = "".join(
            f'<th scope="col"{self._side(k)}>{escape(head)}</th>'
            for k, head in enumerate(self.columns)
        )
        label = escape(self.title or self.caption.split(".")[0])
        tall = " tall" if "information" in self.style else ""
        return "\n".join(
            [
                f'<div class="scroll{tall}" role="group" aria-label="{label}" tabindex="0">',
                f'<table class="{escape(self.style)}"{named}>',
                f"<caption>{' '.join(words)}</caption>",
                *([f"<thead><tr>{heads}</tr></thead>"] * any(self.columns)),
                "<tbody>",
                *map(self._html_row, range(len(self.rows)), self._cells()),
                "</tbody>",
                "</table>",
                "</div>",
            ]
        )

    def __html__(self) -> Markup:
        return Markup(self.to_html())  # noqa: S704

    def __rich__(self) -> Any:
        """The table for a terminal."""
        from rich.table import Table as Drawn
        from rich.text import Text

        drawn = Drawn(title=self.title or None, title_justify="left")
        for k, head in enumerate(self.columns):
            drawn.add_column(head, justify="left" if self._is_left(k) else "right")
        for number, row in enumerate(self._cells(), start=1):
            shown = [Text("\n".join(c.lines), style="bold" if c.is_bold else "") for c in row]
            ends = 0 < self.n_apart == len(self.rows) - number
            drawn.add_row(*shown, end_section=ends)
        return drawn

    def _cells(self) -> Iterator[list[Cell]]:
        for row in self.rows:
            yield [Cell(cell) if isinstance(cell, str) else cell for cell in row]

    def _is_left(self, column: int) -> bool:
        return self.align[min(column, len(self.align) - 1)] == "l"

    def _side(self, column: int) -> str:
        return "" if self._is_left(column) else ' class="number"'

    def _html_row(self, number: int, row: Sequence[Cell]) -> str:
        apart = ' class="apart"' if number >= len(self.rows) - self.n_apart else ""
        cells = []
        for k, cell in enumerate(row):
            tag = 'th scope="row"' if k == 0 else "td"
            value = "" if cell.value is None else f' data-value="{cell.value}"'
            cells.append(f"<{tag}{self._side(k)}{value}>{_html(cell)}</{tag[:2]}>")
        return f"<tr{apart}>{''.join(cells)}</tr>"


def write_tables(path: Path, tables: Sequence[Table], *, words: Sequence[str] = ()) -> None:
    """Write tables as Markdown, or as LaTeX where the file is named ``.tex``; whole or not at all.

    Parameters
    ----------
    path : Path
    tables : sequence of Table
    words : sequence of str
        Paragraphs of Markdown that stand above the tables.
    """
    if path.suffix == ".tex":
        parts = [table.to_latex() for table in tables]
    else:
        parts = [*words, *(table.to_markdown() for table in tables)]
    write_text(path, "\n\n".join(parts) + "\n")


def _row(cells: Any) -> str:
    return f"| {' | '.join(cells)} |"


def _emphasised(cell: Cell, escaped: Any, bold: str, end_of_line: str) -> str:
    """What a cell says, the text itself bold where it stands out."""
    text = end_of_line.join(map(escaped, cell.text.split("\n")))
    first = bold.format(text) if cell.is_bold else text
    first = " ".join(part for part in (first, escaped(cell.beside)) if part)
    return end_of_line.join(part for part in (first, escaped(cell.below)) if part)


def _markdown(text: str) -> str:
    return text.replace("|", r"\|")


def _latex(text: str) -> str:
    text = re.sub(r"([\\{}])", lambda m: {"\\": r"\textbackslash "}.get(m[0], f"\\{m[0]}"), text)
    text = re.sub(r"([&%$#_])", r"\\\1", text)
    for sign, command in (("~", r"\textasciitilde "), ("^", r"\textasciicircum ")):
        text = text.replace(sign, command)
    return text


def _html(cell: Cell) -> str:
    text = "<br>".join(map(escape, cell.text.split("\n")))
    if cell.link:
        text = f'<a href="{escape(cell.link)}">{text}</a>'
    if cell.mark:
        text = f'<span class="{escape(cell.mark)}">{text}</span>'
    if cell.beside:
        text += f' <span class="note">{escape(cell.beside)}</span>'
    if cell.below:
        text += f'<span class="physical">{escape(cell.below)}</span>'
    return text
