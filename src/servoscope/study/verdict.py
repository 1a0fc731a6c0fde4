"""How accurate a study found the camera to be, and what of that is chance, in plain words."""

from __future__ import annotations

from typing import Any

import numpy as np

from servoscope.assessment.page import describe_agreement
from servoscope.poses import DOF_LABELS, DOFS
from servoscope.study.paper import FAMILIES
from servoscope.study.results import Unit, mean_rms, moving_dofs
from servoscope.study.tables import CRITERIA, PARTS, SHOWN, steps_of
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
        f"These are the errors of {FAMILIES[best].title}, the family chosen because it erred least "
        f"on {decide}, on average {mean:.3f} of the range; the subsets selected by mutual "
        f"information reach {selected:.3f}, and always predicting the mean {baseline:.3f}."
    )


def _meaning(unit: Unit) -> str:
    if unit.protocol == "honest":
        return "Errors are of test images that had no part in training or in any decision."
    return "Errors are of test images that also decided when training stops, as published."


PUBLISHED_REDUNDANCY = (
    "The paper gives 0.4 bits, for the PCI vector of Tz at step 8 for Rx. Seven unrelated features "
    "would show 7 × 0.058 = 0.41 bits by chance alone, with its 1000 images and 10 bins."
)


def describe_chance(results: dict[str, Any]) -> str:
    """How much of the redundancy is bias, on the average of the dofs that move."""
    steps, dofs = steps_of(results), moving_dofs(results)
    sentences = []
    for step in steps:
        at_step = [results["redundancy_bias"][dof][step - 1] for dof in dofs]
        redundancy, bias, unrelated = (
            float(np.mean([of_dof[part] for of_dof in at_step])) for part in PARTS
        )
        share = f" ({100 * bias / redundancy:.0f} %)" if redundancy > 0 else ""
        sentences.append(
            f"At step {step} the selected feature shares {redundancy:.2f} bits with those before "
            f"it, on the average of the degrees of freedom, of which {bias:.2f} are bias{share}; "
            f"unrelated features would show {unrelated:.2f}."
        )
    return " ".join([*sentences, *[PUBLISHED_REDUNDANCY] * (8 in steps)])


def describe_criteria(compared: dict[str, Any]) -> str:
    """Which criterion of selection errs least."""
    place = compared["sizes"].index(SHOWN)
    means = {
        name: float(np.mean(list(by_dof.values()), axis=0)[place])
        for name, by_dof in compared["errors"].items()
    }
    best = min(means, key=means.__getitem__)
    published = (
        ""
        if best == "ideal_point"
        else f", against {means['ideal_point']:.3f} by the published ideal-point rule"
    )
    everything = np.mean(list(compared["all_candidates"].values()))
    return (
        f"With {SHOWN} features the error is least when they are selected by "
        f"{CRITERIA.get(best, best)}: {means[best]:.3f} of the range on the average of the "
        f"degrees of freedom{published}. All candidates together reach {everything:.3f}."
    )


def describe_forecasts(forecasts: list[dict[str, Any]]) -> str:
    """How far the forecasts agree with the nets; nothing where there are few."""
    pairs = np.array([(pair["forecast"], pair["reached"]) for pair in forecasts]).reshape(-1, 2)
    agreement = describe_agreement(pairs)
    return agreement and (
        "Errors were also forecast, before training, for the nets of moments, eigenfeatures, "
        f"pose-image covariance and the minimum subsets of Table III. {agreement}"
    )
