"""What is chance in the information that a study went by, in words and as the rows of a table."""

from __future__ import annotations

from typing import Any

import numpy as np

from servoscope.report.averages import moving_dofs
from servoscope.report.names import DOF_LABELS
from servoscope.report.tables import describe_feature

STEPS = (8, 24)
"""The steps of the ranking that the table tells of; the paper tells of the first."""

PARTS = ("redundancy", "bias", "unrelated")
"""What is told of each step, [bits]."""

NULLS = {
    "chi_square": "the chi-square distribution",
    "shifts": "shifts of the sequence, since its images resemble their neighbours",
}
"""What the information was tested against, in words."""

N_FIRST = 8
"""Features of the corrected rule that are named."""


def describe_chance(results: dict[str, Any]) -> dict[str, Any] | None:
    """What the page shows of chance for one protocol and form; None of runs that did not ask.

    Returns
    -------
    dict or None
        ``n_values`` and ``n_chance``, how many values of the mutual information there are and how
        many are not significant; ``null`` in words; ``steps``, the rows of the table by dof in
        ``rows``, and ``sentence``.
    """
    if "mi_significant" not in results:
        return None
    found = [told for row in results["mi_significant"].values() for told in row.values()]
    dofs = moving_dofs(results)
    n_steps = min((len(results["redundancy_bias"][dof]) for dof in dofs), default=0)
    steps = [step for step in STEPS if step <= n_steps]
    return {
        "n_values": len(found),
        "n_chance": found.count(False),
        "null": NULLS[results["mi_null"]],
        "steps": steps,
        "rows": [_row(results, dof, steps) for dof in dofs],
        "sentence": " ".join(
            [_at_step(results, dofs, step) for step in steps] + [_PUBLISHED] * (8 in steps)
        ),
    }


_PUBLISHED = (
    "The paper gives 0.4 bits, for the PCI vector of Tz at step 8 for Rx. Seven unrelated features "
    "would show 7 × 0.058 = 0.41 bits by chance alone, with its 1000 images and 10 bins."
)


def _row(results: dict[str, Any], dof: str, steps: list[int]) -> dict[str, Any]:
    published, corrected = results["table2"][dof], results["table2_corrected"][dof]
    same = [ours == theirs for ours, theirs in zip(published, corrected, strict=True)]
    return {
        "dof": DOF_LABELS[dof],
        "cells": [
            results["redundancy_bias"][dof][step - 1][part] for step in steps for part in PARTS
        ],
        "same_steps": same.index(False) if False in same else len(same),
        "n_shared": len(set(published) & set(corrected)),
        "n_ranked": len(published),
        "features": [describe_feature(name) for name in corrected[:N_FIRST]],
    }


def _at_step(results: dict[str, Any], dofs: list[str], step: int) -> str:
    at_step = [results["redundancy_bias"][dof][step - 1] for dof in dofs]
    redundancy, bias, unrelated = (
        float(np.mean([of_dof[part] for of_dof in at_step])) for part in PARTS
    )
    share = f" ({100 * bias / redundancy:.0f} %)" if redundancy > 0 else ""
    return (
        f"At step {step} the selected feature shares {redundancy:.2f} bits with those before it, "
        f"on the average of the degrees of freedom, of which {bias:.2f} are bias{share}; unrelated "
        f"features would show {unrelated:.2f}."
    )
