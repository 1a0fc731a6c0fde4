"""The page of a study over many cells."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from servoscope.report.page import Part, Section, Verdict, bullets, pairs, write_page
from servoscope.report.table import NONE, Cell, Table
from servoscope.study.cells import FACTORS
from servoscope.study.paper import FAMILIES
from servoscope.wording import listing

Values = dict[str, Any]

READ_SO = (
    "Spearman's rank correlation of the factor with the error of PCI over that of PCA, with its "
    "90 % interval: below 0, PCI gains on PCA as the factor grows. Of {} factors that do nothing "
    "one in ten has an interval without 0 by chance alone."
)


def statements_table(found: Values) -> Table:
    """In what share of the cells each statement of the paper holds."""
    return Table(
        ["The paper says", "Holds in", "90 % interval", "In part", "Not"],
        [
            [
                row["claim"],
                Cell(f"{row['yes']} of {found['n_cells']}", row["share"]),
                _interval(row["interval"]),
                Cell(str(row["partly"]), row["partly"]),
                Cell(str(row["no"]), row["no"]),
            ]
            for row in sorted(found["statements"], key=lambda row: -row["share"])
        ],
        f"The paper's statements over {_counted(found)}",
        "Cells in which a statement holds, with Wilson's 90 % interval of the share in all such "
        "cells; in part: for some displacement forms or degrees of freedom.",
        align="lr",
        name="statements-table",
        style="sortable",
    )


def depends_table(found: Values) -> Table:
    """What goes with the family that is second."""
    return Table(
        ["What differs between cells", "Second in the lower half", "Second in the upper half",
         "Rank correlation", "90 % interval"],
        [
            [
                FACTORS[row["factor"]][0],
                _second(row["low"]),
                _second(row["high"]),
                _correlation(row),
                NONE if row["interval"] is None else _signed(row["interval"]),
            ]
            for row in found["depends"]
        ],
        "What the order of the families depends on",
        READ_SO.format(len(found["depends"])),
        align="lllrr",
        name="depends-table",
    )  # fmt: skip


def describe_order(found: Values) -> str:
    """Which families are second, and what goes with that, in sentences."""
    n, before = found["n_cells"], found["pci_before_pca"]
    clear = [row for row in found["depends"] if _is_clear(row)]
    if not n:
        return "No cell could be studied."
    text = f"Second is {_second(found['second'])} of {n} cells; PCI comes before PCA in {before}."
    if not clear:
        return f"{text} No factor clearly goes with that."
    parts = [
        f"{FACTORS[row['factor']][0].split(',')[0].lower()} ({row['rank_correlation']:+.2f})"
        for row in clear
    ]
    return f"{text} What goes with the error of PCI over that of PCA: {listing(parts)}."


def write_cells_page(path: Path, summary: Mapping[str, Any]) -> Path:
    """Write the page of a study over many cells, whole or not at all."""
    found = summary["found"]
    most = [row for row in found["statements"] if row["interval"][0] > 0.5]
    few = [row for row in found["statements"] if row["interval"][1] < 0.5]
    n = len(found["statements"])
    answer = (
        f"Of {n} statements of the paper {len(most)} hold in most cells, {len(few)} do not, and "
        f"{n - len(most) - len(few)} are open or depend on the cell."
    )
    verdict = Verdict(answer, "assess images of your own robot and view: servoscope assess FOLDER.")
    if n_failed := found.get("n_failed", 0):
        said = f"{n_failed} of {len(summary['cells'])} cells could not be studied"
        verdict = Verdict(
            f"{said}. {answer}" if n else f"{said}.",
            "mend what the table of the cells says, and go on with --resume.",
            "no",
        )
    cells = Table(
        ["Cell", *FACTORS, *(FAMILIES[family].title for family in FAMILIES), "Seconds"],
        [
            [
                _name(one),
                *(Cell(f"{value:.2f}", value) for value in one["factors"].values()),
                *(_number(one["means"].get(family), ".3f") for family in FAMILIES),
                _number(one["seconds"], ".0f"),
            ]
            for one in summary["cells"]
        ],
        "",
        "What differs between the cells, and the mean RMS error of each family over the degrees "
        "of freedom and the displacement forms, of range, under the paper's protocol.",
        align="lr",
        name="cells-table",
        style="sortable",
    )
    ranges = [f"{words}: {low:g} to {high:g}." for words, low, high in FACTORS.values()]
    made = [
        "Each cell has another casting, lights, lens and sensor, and other seeds; the factors are "
        "spread evenly over their ranges, a Latin hypercube:",
        bullets(ranges),
        pairs({"Settings": [(key, str(value)) for key, value in summary["settings"].items()]}),
    ]
    order: list[Part] = [describe_order(found), depends_table(found)]
    sections = [
        Section("What the order depends on", order, "order"),
        Section("The cells", [cells], "cells"),
        Section("How it was made", made, "making"),
    ]
    return write_page(
        path,
        f"Study of {len(summary['cells'])} simulated cells",
        verdict,
        [statements_table(found)],
        sections,
        kind="study",
        lead="Which statements of Wells and Torras (2001) hold whatever the cell, and which depend "
        "on it.",
    )


def _counted(found: Values) -> str:
    """How many cells count, of how many."""
    n, n_failed = found["n_cells"], found.get("n_failed", 0)
    return f"{n} of {n + n_failed} simulated cells" if n_failed else f"{n} simulated cells"


def _name(one: Values) -> Cell:
    number, reason = one["number"], one.get("error")
    if reason is None:
        return Cell(str(number), number)
    return Cell(f"{number} cannot be studied", number, mark="missed", below=reason)


def _number(value: float | None, digits: str) -> str | Cell:
    return NONE if value is None else Cell(format(value, digits), value)


def _interval(ends: list[float]) -> str:
    return f"{100 * ends[0]:.0f} to {100 * ends[1]:.0f} %"


def _signed(ends: list[float]) -> str:
    return f"{ends[0]:+.2f} to {ends[1]:+.2f}"


def _second(counts: Mapping[str, int]) -> str:
    most_first = sorted(counts.items(), key=lambda pair: -pair[1])
    return listing([f"{FAMILIES[family].title} in {n}" for family, n in most_first])


def _is_clear(row: Values) -> bool:
    return row["interval"] is not None and row["interval"][0] * row["interval"][1] > 0


def _correlation(row: Values) -> str | Cell:
    rho = row["rank_correlation"]
    return NONE if rho is None else Cell(f"{rho:+.2f}", rho, mark="best" if _is_clear(row) else "")
