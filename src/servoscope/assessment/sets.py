"""Several assessments side by side: a row for each data set, the worst first, and their page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from servoscope.assessment.page import assessment_verdict
from servoscope.poses import DOFS
from servoscope.report.page import Section, Verdict, bullets, pairs, write_page
from servoscope.report.table import NONE, Cell, Table
from servoscope.wording import plain_number

Row = dict[str, Any]

FAILED = "failed"
"""The state of a data set that could not be read or assessed; others have that of their verdict."""

_WORST_FIRST = (FAILED, "no", "open", "yes")
_IN_WORDS = {"no": "not accurate enough", "open": "no tolerance given", "yes": "accurate enough"}


def row_of(summary: Mapping[str, Any], findings: Sequence[str]) -> Row:
    """What is said of one data set, from the summary of its run.

    Returns
    -------
    dict
        ``dofs[dof]`` has what is ``reached``, in the loop if one was rehearsed, else in one look,
        ``tolerance``, ``unit`` and whether it is ``met``; ``worst`` the largest ratio of what is
        reached to the tolerance, or where none was given to the error of predicting the mean.
    """
    assessed = summary["assessed"]
    verdict = assessment_verdict(assessed)
    dofs = {dof: _reach(row) for dof, row in assessed["dofs"].items()}
    return {
        "state": verdict.state,
        "says": verdict.answer,
        "error": None,
        "dofs": dofs,
        "worst": _worst(dofs, assessed["dofs"]),
        "n_images": summary["dataset"]["n_images"],
        "findings": list(findings),
        "seconds": summary["timings_s"]["total"],
    }


def failed_row(reason: str) -> Row:
    """What is said of a data set that could not be assessed."""
    return {"state": FAILED, "says": reason, "error": reason, "dofs": {}, "worst": None,
            "n_images": None, "findings": [], "seconds": None}  # fmt: skip


def _reach(row: Mapping[str, Any]) -> Row:
    loop, look = row["loop"], row["one_look"]
    by, reached = None, None
    if loop is not None:
        by, reached = "loop", loop["end_rms"]
    elif look is not None:
        by, reached = look["by"], look["rms"]
    met = row["met_in_one_look" if loop is None else "met_in_loop"]
    kept = {"tolerance": row["tolerance"], "unit": row["unit"]}
    return {"reached": reached, "by": by, **kept, "met": met}


def _worst(dofs: Mapping[str, Row], rows: Mapping[str, Any]) -> Row | None:
    """The dof that is farthest from its tolerance, or that is read worst where none is given."""
    asked = [dof for dof, row in dofs.items() if row["tolerance"] is not None]
    ratios = {}
    for dof in asked or [dof for dof, row in dofs.items() if row["reached"] is not None]:
        allowed = dofs[dof]["tolerance"] if asked else rows[dof].get("baseline_rms")
        reached = dofs[dof]["reached"]
        ratios[dof] = reached / allowed if reached is not None and allowed else float("inf")
    if not ratios:
        return None
    dof = max(ratios, key=ratios.__getitem__)
    return {"dof": dof, "ratio": None if ratios[dof] == float("inf") else ratios[dof]}


def worst_first(rows: Sequence[Row]) -> list[Row]:
    """Rows that failed, then those that are not accurate enough; each kind by its worst ratio."""

    def place(row: Row) -> tuple[int, float, str]:
        ratio = (row["worst"] or {}).get("ratio")
        return (
            _WORST_FIRST.index(row["state"]),
            -float("inf") if ratio is None else -ratio,
            row["name"],
        )

    return sorted(rows, key=place)


def sets_table(rows: Sequence[Row]) -> Table:
    """A row for each data set: its verdict, and what is reached of each dof."""
    return Table(
        ["Data set", "Verdict", *DOFS, "Images"],
        [
            [
                Cell(row["name"], link=f"{row['run']}/report.html" if row["run"] else ""),
                _verdict(row),
                *(_cell(row["dofs"].get(dof)) for dof in DOFS),
                NONE if row["n_images"] is None else Cell(str(row["n_images"]), row["n_images"]),
            ]
            for row in rows
        ],
        "Data sets, the worst first",
        "RMS error that each degree of freedom reaches on new images, over the tolerance: where "
        "the rehearsed loop ends, or in one look where no keyframe explains the view. Names lead "
        "to the reports.",
        align="llr",
        name="sets-table",
        style="sortable",
    )


def _verdict(row: Row) -> Cell:
    if row["state"] == FAILED:
        return Cell("cannot be assessed", mark="missed", below=row["error"])
    return Cell(_IN_WORDS[row["state"]], mark="missed" if row["state"] == "no" else "")


def _cell(dof: Row | None) -> str | Cell:
    if dof is None or (dof["reached"] is None and dof["tolerance"] is None):
        return NONE
    reached = NONE if dof["reached"] is None else plain_number(dof["reached"])
    over = "" if dof["tolerance"] is None else f"/ {plain_number(dof['tolerance'])} "
    mark = "missed" if dof["met"] is False else ""
    return Cell(reached, dof["reached"], mark, beside=f"{over}{dof['unit']}")


def sets_verdict(rows: Sequence[Row]) -> Verdict:
    """How many data sets will do, and which is to be seen to first."""
    counts = {state: sum(row["state"] == state for row in rows) for state in _WORST_FIRST}
    parts = [f"{counts[state]} {words}" for state, words in _IN_WORDS.items() if counts[state]]
    parts += [f"{counts[FAILED]} cannot be assessed"] * bool(counts[FAILED])
    answer = f"Of {len(rows)} data sets {', '.join(parts)}."
    if counts[FAILED]:
        step = f"mend {rows[0]['name']}: {rows[0]['says']} Then go on with --resume."
        return Verdict(answer, step, "no")
    if counts["no"]:
        return Verdict(answer, f"see the report of {rows[0]['name']}, the worst.", "no")
    if counts["open"]:
        return Verdict(answer, "say which errors are allowed: --tolerance, such as t=1mm.")
    return Verdict(answer, "train models: servoscope train DATASET.", "yes")


def write_sets_page(path: Path, rows: Sequence[Row], settings: Mapping[str, Any]) -> Path:
    """Write the page of several assessments, whole or not at all.

    Parameters
    ----------
    path : Path
    rows : sequence of dict
        In the order in which they are to be shown.
    settings : dict
        Of the assessments.
    """
    said = bullets(f"{row['name']}: {row['says']}" for row in rows)
    findings = [f"{row['name']}: {text}" for row in rows for text in row["findings"]]
    found = bullets(findings) if findings else "Nothing was found that is wrong with the images."
    tolerances = [*settings["tolerance"].items()] or [("none", NONE)]
    shown = [
        (key, ", ".join(map(str, value)) if isinstance(value, list) else value)
        for key, value in settings.items()
        if isinstance(value, str | int | list)
    ]
    made = pairs({"Settings": shown, "Tolerances, mm and deg": tolerances})
    sections = [
        Section("What is said of each data set", [said], "said"),
        Section("What is wrong with the images", [found], "findings"),
        Section("How it was made", [made], "making"),
    ]
    return write_page(
        path,
        f"Assessment of {len(rows)} data sets",
        sets_verdict(rows),
        [sets_table(rows)],
        sections,
        kind="assessment",
        lead="How accurately each degree of freedom of the camera can be read from an image, of "
        "every data set side by side.",
    )
