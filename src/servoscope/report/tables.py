"""The rows of the report's tables, beside the published numbers."""

from __future__ import annotations

from typing import Any

import numpy as np

from servoscope.poses import DOFS
from servoscope.report.averages import mean_rms, moving_dofs
from servoscope.report.names import DOF_LABELS, FAMILY_NAMES, feature_family
from servoscope.study.paper import FAMILIES, FAMILY_TITLES, TABLE1, TABLE3, table2

FAMILY_MARKS = {"gm": "●", "pca": "□", "pci": "▲"}
"""Stand before the names of features, so that families differ without colour too."""


def rms_table(results: dict[str, Any]) -> list[dict[str, Any]]:
    """Table I: one row a family, then the selected features, then the mean as only answer.

    Each row has its ``title`` and ``name``, ``cells`` (``rms``, ``physical``, ``published``, and
    whether the dof ``moves``) in `DOFS` order, and the same for the ``mean`` of those that do.
    """
    rows = [
        _rms_row(results, FAMILY_TITLES[f], FAMILY_NAMES[f], results["table1"][f], TABLE1[f])
        for f in FAMILIES
    ]
    published = {dof: float(TABLE3[dof]["rms"]) for dof in DOFS}
    selected = _rms_row(
        results, "Selected", "minimum subsets, Table III", results["table3"], published
    )
    baseline = _rms_row(results, "Baseline", "predicting the mean", results["baseline"], None)
    best = [min(row["cells"][i]["rms"] for row in rows) for i in range(len(DOFS))]
    for row in rows:
        for cell, least in zip(row["cells"], best, strict=True):
            cell["best"] = cell["moves"] and cell["rms"] == least
    return [*rows, selected, baseline]


def ranking_table(results: dict[str, Any]) -> list[list[dict[str, Any]]]:
    """Table II: one row a step; in each, by dof, the feature and the published one.

    ``shared`` tells that the feature is among the published 24 of that dof, ``published_shared``
    that the published one is among those of this run.
    """
    ours = {dof: results["table2"][dof] for dof in DOFS}
    theirs = {dof: table2(dof) for dof in DOFS}
    n_steps = max(map(len, ours.values()))
    return [
        [_ranking_cell(ours[dof], theirs[dof], step) for dof in DOFS] for step in range(n_steps)
    ]


def subset_table(results: dict[str, Any]) -> list[dict[str, Any]]:
    """Table III: one row a dof."""
    return [
        {
            **results["table3"][dof],
            "dof": DOF_LABELS[dof],
            "features": [describe_feature(name) for name in results["table3"][dof]["features"]],
            "published_rms": TABLE3[dof]["rms"],
            "published_n": TABLE3[dof]["n_features"],
        }
        for dof in DOFS
    ]


def information_table(results: dict[str, Any]) -> list[dict[str, Any]]:
    """Mutual information: one row a candidate, in bits.

    In each of its ``cells``, ``best`` marks the most for that dof, ``chance`` what is not
    significant; ``corrected`` is the same less its bias, None of a run that did not ask.
    """
    rows = results["mi"]
    best = {dof: max(row[dof] for row in rows.values()) for dof in DOFS}
    significant, corrected = results.get("mi_significant"), results.get("mi_corrected")
    return [
        {
            **describe_feature(name),
            "cells": [
                {
                    "bits": row[dof],
                    "best": row[dof] == best[dof],
                    "chance": significant is not None and not significant[name][dof],
                    "corrected": None if corrected is None else corrected[name][dof],
                }
                for dof in DOFS
            ],
        }
        for name, row in rows.items()
    ]


def stability_table(results: dict[str, Any]) -> list[dict[str, Any]]:
    """How the order depends on the bins: one row a number of bins.

    Each of its ``cells`` tells how many first ``steps`` are those of the study's own number of
    bins, and the ``overlap`` of the features selected, 0 to 1.
    """
    rows = [results["stability"][dof] for dof in DOFS]
    return [
        {
            "n_bins": same_bins[0]["n_bins"],
            "cells": [
                {"steps": cell["same_steps"], "overlap": cell["overlap"]} for cell in same_bins
            ],
        }
        for same_bins in zip(*rows, strict=True)
    ]


def _rms_row(
    results: dict[str, Any],
    title: str,
    name: str,
    row: dict[str, dict[str, Any]],
    published: dict[str, float] | None,
) -> dict[str, Any]:
    moving = moving_dofs(results)
    cells = [
        {
            "rms": row[dof]["rms"],
            "physical": row[dof]["physical"],
            "unit": row[dof]["unit"],
            "published": published[dof] if published else None,
            "moves": dof in moving,
            "best": False,
        }
        for dof in DOFS
    ]
    mean = {
        "rms": mean_rms(results, row),
        "published": float(np.mean([published[d] for d in moving]))
        if published and moving
        else None,
    }
    return {"title": title, "name": name, "cells": cells, "mean": mean}


def _ranking_cell(ours: list[str], theirs: list[str], step: int) -> dict[str, Any]:
    name = ours[step] if step < len(ours) else None
    published = theirs[step] if step < len(theirs) else None
    return {
        "ours": None if name is None else {**describe_feature(name), "shared": name in theirs},
        "published": None
        if published is None
        else {**describe_feature(published), "shared": published in ours},
    }


def describe_feature(name: str) -> dict[str, str]:
    """The name of a feature, its family, and the mark of that."""
    family = feature_family(name)
    return {"name": name, "family": family, "mark": FAMILY_MARKS[family]}
