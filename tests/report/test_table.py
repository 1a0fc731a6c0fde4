"""One table, four renderings: the same cells in each, and nothing of a cell taken for a command."""

import csv
import io
import re

import pytest
from rich.console import Console

from servoscope.report.table import Cell, Table, write_tables

HOSTILE = "a|b <i>&amp; 50 % \\cmd{x} $y_1$ #2 ~^"
TABLE = Table(
    ["dof", "RMS", "note"],
    [
        ["tx", Cell("0.5", 0.5, "best", beside="(0.7)", below="12 mm"), HOSTILE],
        ["tz", Cell("1.5", 1.5), "two\nlines"],
        ["mean", "1.0", ""],
    ],
    "Errors",
    "Of all.",
    align="lrl",
    name="errors",
    style="sortable",
    n_apart=1,
)


def test_markdown_has_a_line_a_row_and_every_cell():
    title, _, heads, rule, first, second, last = TABLE.to_markdown().split("\n")
    assert (title, rule) == ("**Errors**", "| :-- | --: | :-- |")
    assert {line.replace("\\|", "").count("|") for line in (heads, first, second, last)} == {4}
    assert "| **0.5** (0.7)<br>12 mm |" in first
    assert "two<br>lines" in second


def test_latex_escapes_what_it_would_take_for_a_command():
    latex = TABLE.to_latex()
    assert r"\begin{tabular}{lrl}" in latex
    assert r"\shortstack[r]{\textbf{0.5} (0.7) \\ 12 mm}" in latex
    assert r"50 \% \textbackslash cmd\{x\} \$y\_1\$ \#2 \textasciitilde \textasciicircum" in latex
    assert latex.count(r"\midrule") == 2
    unescaped = re.findall(r"(?<!\\)[%$#]|(?<!\\)_", latex)
    assert not unescaped


def test_html_escapes_and_marks_what_is_sorted_and_set_apart():
    html = TABLE.to_html()
    assert "a|b &lt;i&gt;&amp;amp; 50 %" in html
    assert '<td class="number" data-value="0.5"><span class="best">0.5</span>' in html
    assert html.count('<tr class="apart">') == 1
    assert '<table class="sortable" id="errors">' in html


def test_a_terminal_shows_every_cell():
    out = Console(width=120, record=True, file=io.StringIO())
    out.print(TABLE)
    text = out.export_text()
    for part in ("Errors", "0.5 (0.7)", "12 mm", HOSTILE, "two", "lines", "mean"):
        assert part in text


@pytest.mark.parametrize(("name", "part"), [("t.md", "| tz |"), ("t.tex", r"\toprule")])
def test_tables_are_written_as_the_file_is_named(tmp_path, name, part):
    write_tables(tmp_path / name, [TABLE, TABLE], words=["Said above."])
    text = (tmp_path / name).read_text()
    assert text.count(part) == 2
    assert text.endswith("\n")


def test_csv_is_read_back_with_numbers_as_they_are():
    read = list(csv.reader(io.StringIO(TABLE.to_csv())))
    assert read[0] == list(TABLE.columns)
    assert len(read) == 1 + len(TABLE.rows)
    cells = [Cell(cell) if isinstance(cell, str) else cell for cell in TABLE.rows[0]]
    shown = [" ".join(c.lines) if c.value is None else str(c.value) for c in cells]
    assert read[1] == shown
