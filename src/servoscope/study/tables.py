"""The tables of a study, beside the published numbers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from servoscope.poses import DOF_LABELS, DOFS
from servoscope.report.table import NONE, Cell, Table
from servoscope.study.paper import FAMILIES, TABLE1, TABLE3, family_of, table2
from servoscope.study.results import Unit, mean_rms, moving_dofs

LABELS = tuple(DOF_LABELS.values())

CRITERIA = {
    "ideal_point": "ideal point (published)",
    "ideal_point_corrected": "ideal point, corrected",
    "jmi": "JMI",
    "forecast": "forecast error",
}
"""The criteria of selection in words."""

SHOWN = 8
"""The number of features for which the table of the criteria has the error of every dof."""

STEPS = (8, 24)
"""The steps of the ranking whose redundancy is shown; the paper gives that of the first."""

PARTS = ("redundancy", "bias", "unrelated")
"""What is shown of each step, [bits]."""

NULLS = {
    "chi_square": "the chi-square distribution",
    "shifts": "shifts of the sequence, since its images resemble their neighbours",
}
"""What the information was tested against, in words."""

N_FIRST = 8
"""Features of the corrected rule that are named."""


def study_tables(unit: Unit, n_bins: int | None) -> list[Table]:
    """All tables of one protocol and displacement form, in the order of the page."""
    tables = [errors_table(unit), ranking_table(unit), subset_table(unit), information_table(unit)]
    if has_chance(unit.results):
        tables.append(redundancy_table(unit))
    return [*tables, stability_table(unit, n_bins)]


def errors_table(unit: Unit, name: str = "", *, is_brief: bool = False) -> Table:
    """Table I:

    one row a family, then the selected features, then the mean as only answer. `name` is of its
    place on the page; a brief one names the rows by their titles alone, for a terminal.
    """
    results, moving = unit.results, moving_dofs(unit.results)
    families = results["table1"]
    least = {dof: min(families[f][dof]["rms"] for f in FAMILIES) for dof in moving}

    def row(title: str, errors: Any, published: Any, marked: bool = False) -> list[Cell]:
        cells = [Cell(NONE)] * len(DOFS)
        for k, dof in enumerate(DOFS):
            if dof in moving:
                rms, best = errors[dof]["rms"], marked and errors[dof]["rms"] == least[dof]
                cells[k] = Cell(
                    f"{rms:.3f}",
                    rms,
                    "best" * best,
                    beside=f"({published[dof]:.2f})" if published else "",
                    below=f"{errors[dof]['physical']:.2f} {errors[dof]['unit']}",
                )
        mean = mean_rms(results, errors)
        theirs = np.mean([published[dof] for dof in moving]) if published and moving else None
        beside = "" if theirs is None else f"({theirs:.2f})"
        shown = Cell(title.split("\n")[0] if is_brief else title)
        return [shown, *cells, Cell(f"{mean:.3f}", mean, beside=beside)]

    rows = [
        row(f"{family.title}\n{family.words}", families[name], TABLE1[name], marked=True)
        for name, family in FAMILIES.items()
    ]
    published = {dof: TABLE3[dof]["rms"] for dof in DOFS}
    rows += [
        row("Selected\nminimum subsets, Table III", results["table3"], published),
        row("Baseline\npredicting the mean", results["baseline"], None),
    ]
    return Table(
        ["Features", *LABELS, "Mean"],
        rows,
        "Table I",
        "RMS test error of nets that take each family: of the range, in mm or degrees, and as "
        f"published (in brackets). The least of the five families is bold. {unit.title}.",
        name=f"{name or unit.name}-table1",
        style="sortable rms",
        n_apart=2,
    )


def ranking_table(unit: Unit) -> Table:
    """Table II: one row a step; in each, by dof, the feature and the published one."""
    lists = [(unit.results["table2"][dof], table2(dof)) for dof in DOFS]
    rows: list[list[str | Cell]] = [
        [
            str(step + 1),
            *(
                _feature(one[step], other) if step < len(one) else Cell("")
                for ours, theirs in lists
                for one, other in ((ours, theirs), (theirs, ours))
            ),
        ]
        for step in range(max(len(ours) for ours, _ in lists))
    ]
    signs = ", ".join(
        f"{FAMILIES[name].sign} {FAMILIES[name].words}" for name in ("gm", "pca", "pci")
    )
    return Table(
        ["Step", *(head for label in LABELS for head in (label, "paper"))],
        rows,
        "Table II",
        "The first features for each degree of freedom in order of selection, beside the published "
        f"ones. {signs}; underlined: in both lists of that degree of freedom.",
        align="l",
        name=f"{unit.name}-table2",
        style="ranking",
    )


def subset_table(unit: Unit) -> Table:
    """Table III: one row a dof."""
    rows: list[list[str | Cell]] = []
    for dof in DOFS:
        row = unit.results["table3"][dof]
        published = {"rms": TABLE3[dof]["rms"], "n": TABLE3[dof]["n_features"]}
        rows.append(
            [
                DOF_LABELS[dof],
                Cell(f"{row['rms']:.3f}", row["rms"], beside=f"({published['rms']:.2f})"),
                Cell(f"{row['physical']:.2f} {row['unit']}", row["physical"]),
                Cell(f"{row['n_features']}", row["n_features"], beside=f"({published['n']})"),
                Cell(f"{row['threshold']:.2f}", row["threshold"]),
                _signed(row["features"]),
            ]
        )
    mean = mean_rms(unit.results, unit.results["table3"])
    return Table(
        ["Dof", "RMS of range", "RMS", "Features", "Threshold [bits]", "Which"],
        rows,
        "Table III",
        "The subset of ranked features that errs least, for each degree of freedom; as published "
        f"in brackets. The mean RMS is {mean:.3f} of the range.",
        align="lrrrrl",
        name=f"{unit.name}-table3",
        style="sortable features",
    )


def information_table(unit: Unit) -> Table:
    """Mutual information: one row a candidate, in bits."""
    results = unit.results
    rows, with_chance = results["mi"], has_chance(results)
    best = {dof: max(row[dof] for row in rows.values()) for dof in DOFS}

    def cell(name: str, dof: str) -> Cell:
        bits, corrected = rows[name][dof], ""
        text, mark = f"{bits:.3f}", "best" if bits == best[dof] else ""
        if with_chance:
            corrected = f"{round(results['mi_corrected'][name][dof], 3) + 0.0:.3f}"
            if not results["mi_significant"][name][dof]:
                text, mark = f"({text})", "chance"
        return Cell(text, bits, mark, beside=corrected)

    caption = (
        "of every candidate with every degree of freedom, in bits; the most for each is bold. "
        f"Counting alone makes unrelated variables show {results['mi_null_level']:.3f} bits. "
    )
    if with_chance:
        found = [one for row in results["mi_significant"].values() for one in row.values()]
        caption += (
            "In small print: the same less its own bias (Miller-Madow). In brackets: the "
            f"{found.count(False)} of {len(found)} values that do not differ from chance, by "
            f"{NULLS[results['mi_null']]}; of those without brackets 5 % at most are expected to "
            "be chance (Benjamini and Hochberg). "
        )
    return Table(
        ["Feature", *LABELS],
        [[_signed([name]), *(cell(name, dof) for dof in DOFS)] for name in rows],
        "Mutual information",
        f"{caption}The paper prints no such table; it calls 0.1 bits typical of unrelated "
        "variables.",
        name=f"{unit.name}-mi",
        style="sortable information",
    )


def has_chance(results: dict[str, Any]) -> bool:
    """Whether a run asked what of the information is chance; older ones did not."""
    return "mi_significant" in results


def steps_of(results: dict[str, Any]) -> list[int]:
    """Those of `STEPS` that every dof has."""
    n_steps = [len(results["redundancy_bias"][dof]) for dof in moving_dofs(results)]
    return [step for step in STEPS if step <= min(n_steps, default=0)]


def redundancy_table(unit: Unit) -> Table:
    """How much of the redundancy is bias, and what the corrected rule selects: one row a dof."""
    results, steps = unit.results, steps_of(unit.results)
    rows: list[list[str | Cell]] = []
    for dof in moving_dofs(results):
        published, corrected = results["table2"][dof], results["table2_corrected"][dof]
        same = [ours == theirs for ours, theirs in zip(published, corrected, strict=True)]
        of_steps = results["redundancy_bias"][dof]
        rows.append(
            [
                DOF_LABELS[dof],
                *(f"{of_steps[step - 1][part]:.2f}" for step in steps for part in PARTS),
                str([*same, False].index(False)),
                f"{len(set(published) & set(corrected))} of {len(published)}",
                _signed(corrected[:N_FIRST]),
            ]
        )
    heads = [head for step in steps for head in (f"Step {step}", "Bias", "Unrelated")]
    return Table(
        ["Dof", *heads, "Same steps", "Shared", "First by the corrected rule"],
        rows,
        "How much of the redundancy is bias",
        "in bits, at two steps: the redundancy, the bias in it (Miller-Madow, too little for few "
        "images), and what as many unrelated features would show; and what the ideal-point rule "
        "selects when relevance and redundancy are corrected for it: for how many first steps the "
        "same as in Table II, how many of the same features, and the first ones.",
        align="l" + "r" * (len(heads) + 2) + "l",
        name=f"{unit.name}-redundancy",
        style="features",
    )


def stability_table(unit: Unit, n_bins: int | None) -> Table:
    """How the order depends on the bins: one row a number of bins."""
    by_dof = [unit.results["stability"][dof] for dof in DOFS]
    of = f"{n_bins} bins" if n_bins else "the number of bins of the study"
    return Table(
        ["Bins", *LABELS],
        [
            [
                Cell(str(cells[0]["n_bins"]), cells[0]["n_bins"]),
                *(
                    Cell(
                        str(c["same_steps"]), c["same_steps"], beside=f"{100 * c['overlap']:.0f} %"
                    )
                    for c in cells
                ),
            ]
            for cells in zip(*by_dof, strict=True)
        ],
        "Order by number of bins",
        f"How many first steps select what {of} select, and the share of the ranked features that "
        "both select. The paper found one order for all of them.",
        align="r",
        name=f"{unit.name}-bins",
        style="sortable",
    )


def criteria_table(compared: dict[str, Any]) -> Table:
    """The criteria side by side: the mean error by number of features, and that of every dof."""
    dofs, place = list(compared["all_candidates"]), compared["sizes"].index(SHOWN)
    values = {
        name: [
            *np.mean(list(by_dof.values()), axis=0).tolist(),
            *(by_dof[dof][place] for dof in dofs),
        ]
        for name, by_dof in compared["errors"].items()
    }
    least = np.min(list(values.values()), axis=0)
    sizes = [f"{size} features" for size in compared["sizes"]]
    return Table(
        ["Criterion", *sizes, *(f"{DOF_LABELS[dof]}, {SHOWN}" for dof in dofs)],
        [
            [CRITERIA.get(name, name), *map(_error, errors, errors == least)]
            for name, errors in values.items()
        ],
        "",
        "RMS test error of nets, of range, by the criterion that selected their features: on the "
        f"average of the degrees of freedom by number of features, and of each with {SHOWN} of "
        "them. The least of each column is bold.",
        name="criteria-table",
        style="sortable",
    )


def _error(rms: float, is_best: bool) -> Cell:
    return Cell(f"{rms:.3f}", rms, "best" * bool(is_best))


def _signed(features: Sequence[str]) -> Cell:
    """Names of features, each after the sign of its family."""
    return Cell("  ".join(f"{FAMILIES[family_of(name)].sign} {name}" for name in features))


def _feature(name: str, others: Sequence[str]) -> Cell:
    return Cell(_signed([name]).text, mark="shared" * (name in others))
