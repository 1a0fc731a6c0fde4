"""The rows of an assessment's tables."""

from __future__ import annotations

from typing import Any

import numpy as np

from servoscope.assessment.disturbed import TITLES
from servoscope.report.criteria import describe_agreement
from servoscope.report.names import DOF_LABELS
from servoscope.wording import plain_number

REGRESSORS = {
    "gaussian_process": "Gaussian process (default)",
    "kernel_ridge": "kernel ridge",
    "levenberg_marquardt": "the paper's nets",
    "bayesian_lm": "nets, Bayesian weight decay",
    "lbfgs": "nets by L-BFGS",
}
"""The regressors in words."""


def describe_assessment(assessed: dict[str, Any], figures: list[dict[str, Any]]) -> dict[str, Any]:
    """Everything that the page shows of an assessment."""
    dofs = [dof for dof, row in assessed["dofs"].items() if row["forecast_rms"] is not None]
    return {
        "conclusion": assessed["conclusion"],
        "warnings": assessed["warnings"],
        "images": assessed["images"],
        "rows": [_decision(dof, row) for dof, row in assessed["dofs"].items()],
        "figures": figures,
        "heads": [f"{DOF_LABELS[dof]} [{assessed['dofs'][dof]['unit']}]" for dof in dofs],
        "families": _families(assessed["families"], dofs),
        "agreement": _agreement(assessed, dofs),
        "regressors": _regressors(assessed["regressors"], dofs),
        "regressors_on_moments": _regressors(assessed["regressors_on_moments"], dofs),
        "disturbed": [
            {"title": TITLES.get(name, name), "cells": [errors[dof] for dof in dofs]}
            for name, errors in assessed["disturbed"].items()
        ],
    }


def reach_cells(row: dict[str, Any]) -> tuple[str, str, str, str]:
    """Tolerance, one look, end of the loop, and the limit of the view; a dash for none."""
    unit, look, loop = row["unit"], row["one_look"], row["loop"]
    reads = "–"
    if look is not None:
        low, high = map(plain_number, look["interval"])
        reads = f"{plain_number(look['rms'])} {unit} by {look['by']}\n({low} to {high})"
    return (
        _number(row["tolerance"], unit),
        reads,
        _number(None if loop is None else loop["end_rms"], unit),
        _number(row["view_limit"], unit),
    )


def _number(value: float | None, unit: str) -> str:
    return "–" if value is None else f"{plain_number(value)} {unit}"


def _decision(dof: str, row: dict[str, Any]) -> dict[str, Any]:
    tolerance, look, loop, limit = reach_cells(row)
    shown = {
        "label": DOF_LABELS[dof],
        "observable": row["observable"],
        "limited_by": row["limited_by"],
        "family": row.get("family", "–"),
        "features": ", ".join(row["best_features"]),
        "advice": row["advice"],
        "tolerance": tolerance,
        "one_look": look,
        "loop": loop,
        "view_limit": limit,
        "met_in_loop": row["met_in_loop"],
        "met_in_one_look": row["met_in_one_look"],
    }
    if row["forecast_rms"] is None:
        return {**shown, "forecast": "–", "interval": "", "reached": "–"}
    low, high = map(plain_number, row["interval"])
    return {
        **shown,
        "forecast": _number(row["forecast_rms"], row["unit"]),
        "interval": f"{low} to {high}",
        "reached": _number(row["reached_rms"], row["unit"]),
    }


def _regressors(rows: list[dict[str, Any]], dofs: list[str]) -> list[dict[str, Any]]:
    return [
        {
            "title": REGRESSORS.get(row["regressor"], row["regressor"]),
            "cells": [row["rms"][dof] for dof in dofs],
            "seconds": row["seconds"],
            "covered": row["coverage_95"],
        }
        for row in rows
    ]


def _families(families: dict[str, Any], dofs: list[str]) -> list[dict[str, Any]]:
    least = {
        dof: min(family["dofs"][dof]["forecast_rms"] for family in families.values())
        for dof in dofs
    }
    return [
        {
            "title": family["title"],
            "n_features": family["n_features"],
            "cells": [
                {
                    "forecast": family["dofs"][dof]["forecast_rms"],
                    "reached": family["dofs"][dof]["reached_rms"],
                    "best": family["dofs"][dof]["forecast_rms"] == least[dof],
                }
                for dof in dofs
            ],
        }
        for family in families.values()
    ]


def _agreement(assessed: dict[str, Any], dofs: list[str]) -> str:
    """How far the forecasts agree with what was reached; nothing where there are few."""
    pairs = np.array(
        [
            [
                family["dofs"][dof][key] / (assessed["dofs"][dof]["baseline_rms"] or 1.0)
                for key in ("forecast_rms", "reached_rms")
            ]
            for family in assessed["families"].values()
            for dof in dofs
            if family["dofs"][dof]["reached_rms"] is not None
        ]
    ).reshape(-1, 2)
    return describe_agreement(pairs)
