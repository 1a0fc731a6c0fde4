"""Averages over the degrees of freedom; those that never moved have no error to average."""

from __future__ import annotations

from typing import Any

import numpy as np

from servoscope.poses import DOFS


def moving_dofs(results: dict[str, Any]) -> list[str]:
    """The degrees of freedom that moved, in `DOFS` order.

    Parameters
    ----------
    results : dict
        Of one protocol and displacement form.
    """
    return [dof for dof in DOFS if results["ranges"][dof]["value"] is not None]


def mean_rms(results: dict[str, Any], row: dict[str, dict[str, Any]]) -> float:
    """Mean of the RMS errors in a row of a table of `results`, of range; 0 if nothing moved."""
    errors = [row[dof]["rms"] for dof in moving_dofs(results)]
    return float(np.mean(errors)) if errors else 0.0
