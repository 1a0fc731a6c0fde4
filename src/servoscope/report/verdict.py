"""How accurate a study found the camera to be, in plain words."""

from __future__ import annotations

from typing import Any

from servoscope.poses import DOFS
from servoscope.report.averages import mean_rms
from servoscope.report.names import DOF_LABELS
from servoscope.report.run_data import Unit
from servoscope.study.paper import FAMILY_TITLES
from servoscope.wording import listing

WELL, ROUGHLY = 0.25, 0.6
"""Shares of the baseline error below which a degree of freedom is observable well, or roughly."""

SENTENCES = {
    "well": "{} observable well from one image",
    "roughly": "{} observable roughly",
    "hardly": "{} hardly observable",
    "not": "{} not observable: the mean does as well",
    "still": "{} never moved",
}


def describe_accuracy(unit: Unit) -> list[str]:
    """Sentences on what the best family and the selected features reach."""
    results = unit.results
    errors = results["table1"][results["best_family"]]
    grades: dict[str, list[str]] = {grade: [] for grade in SENTENCES}
    for dof in DOFS:
        grades[_grade(errors[dof], results["baseline"][dof])].append(dof)
    parts = [
        SENTENCES[grade].format(_subject(dofs, errors, grade))
        for grade, dofs in grades.items()
        if dofs
    ]
    text = "; ".join(parts)
    return [f"{text[0].upper()}{text[1:]}.", _best_family(unit), _meaning(unit)]


def _grade(error: dict[str, Any], baseline: dict[str, Any]) -> str:
    if baseline["rms"] <= 1e-9:
        return "still"
    share = error["rms"] / baseline["rms"]
    if share >= 1.0:
        return "not"
    return "well" if share <= WELL else "roughly" if share <= ROUGHLY else "hardly"


def _subject(dofs: list[str], errors: dict[str, Any], grade: str) -> str:
    if grade == "still":
        return listing([DOF_LABELS[dof] for dof in dofs])
    subjects = [
        DOF_LABELS[dof]
        + f" (to {errors[dof]['physical']:.2g} {errors[dof]['unit']})" * (grade != "not")
        for dof in dofs
    ]
    return f"{listing(subjects)} {'is' if len(dofs) == 1 else 'are'}"


def _best_family(unit: Unit) -> str:
    results, best = unit.results, unit.results["best_family"]
    mean, selected, baseline = (
        mean_rms(results, row)
        for row in (results["table1"][best], results["table3"], results["baseline"])
    )
    n_images = results["n_images"]
    decide = (
        f"the {n_images['validation']} images that decide"
        if unit.protocol == "honest"
        else f"the {n_images['test']} test images themselves"
    )
    return (
        f"These are the errors of {FAMILY_TITLES[best]}, the family chosen because it erred least "
        f"on {decide}, on average {mean:.3f} of the range; the subsets selected by mutual "
        f"information reach {selected:.3f}, and always predicting the mean {baseline:.3f}."
    )


def _meaning(unit: Unit) -> str:
    if unit.protocol == "honest":
        return "Errors are of test images that had no part in training or in any decision."
    return "Errors are of test images that also decided when training stops, as published."
