"""How much of the information that a study goes by is there by chance."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.pipeline import FeatureTable
from servoscope.poses import DOFS
from servoscope.selection import (
    Candidates,
    corrected_mutual_information,
    information_test,
    rank_ideal_point_corrected,
    redundancy_bias,
)
from servoscope.study.assessment import Assessment
from servoscope.study.feature_tables import CANDIDATES

CORRECTION = "miller_madow"
"""Right for features that tell of a dof and for those that do not; see `information_bias`."""


def measure_chance(
    assessment: Assessment,
    table: FeatureTable,
    targets: NDArray[np.float64],
    samples: NDArray[np.intp],
    *,
    in_sequence: bool = False,
    n_bins: int = 10,
) -> dict[str, Any]:
    """What chance adds to the information, the redundancy and the order of an assessment.

    Parameters
    ----------
    assessment : Assessment
    table : FeatureTable
    targets : ndarray of shape (n_images, 6)
        Displacements, in `DOFS` order.
    samples : ndarray
        Indices of the images that were assessed; in the order of time if they are a sequence.
    in_sequence : bool
        Whether images resemble their neighbours. Then features are tested against shifts of the
        sequence, else against the chi-square distribution.
    n_bins : int
        As in the assessment.

    Returns
    -------
    dict
        Plain values: ``mi_corrected[feature][dof]`` in bits, by ``mi_correction``;
        ``mi_significant[feature][dof]``, at most 5 % of the findings among all features and dofs
        being wrong, by the null distribution ``mi_null``; ``redundancy_bias[dof]``, for every
        step of the ranking its ``redundancy``, how much of that is ``bias`` by the same
        correction, which is too little where there are few images, and what as many ``unrelated``
        features would show; and ``table2_corrected[dof]``, names in the order of the corrected
        ideal-point rule.
    """
    X, Y = table.values[np.ix_(samples, table.columns(CANDIDATES))], targets[samples]
    null = "shifts" if in_sequence else "chi_square"
    corrected = corrected_mutual_information(X, Y, n_bins, CORRECTION)
    test = information_test(X, Y, n_bins, null=null)
    return {
        "mi_correction": CORRECTION,
        "mi_corrected": _by_feature(assessment.names, corrected),
        "mi_null": null,
        "mi_significant": _by_feature(assessment.names, test.significant),
        "redundancy_bias": {dof: _redundancy(X, assessment, dof, n_bins) for dof in DOFS},
        "table2_corrected": {
            dof: _corrected_order(X, y, assessment, dof, n_bins)
            for dof, y in zip(DOFS, Y.T, strict=True)
        },
    }


def _by_feature(names: list[str], values: NDArray[Any]) -> dict[str, dict[str, Any]]:
    return {
        name: dict(zip(DOFS, row, strict=True))
        for name, row in zip(names, values.tolist(), strict=True)
    }


def _redundancy(
    X: NDArray[np.float64], assessment: Assessment, dof: str, n_bins: int
) -> list[dict[str, float]]:
    ranking = assessment.rankings[dof]
    steps = {
        "redundancy": ranking.redundancy,
        "bias": redundancy_bias(X, ranking, n_bins, CORRECTION),
        "unrelated": redundancy_bias(X, ranking, n_bins, "permutation"),
    }
    return [
        dict(zip(steps, values, strict=True))
        for values in np.column_stack(list(steps.values())).tolist()
    ]


def _corrected_order(
    X: NDArray[np.float64], y: NDArray[np.float64], assessment: Assessment, dof: str, n_bins: int
) -> list[str]:
    n_ranked = len(assessment.rankings[dof].order)
    ranking = rank_ideal_point_corrected(Candidates(X, y, n_bins), n_ranked, CORRECTION)
    return [assessment.names[i] for i in ranking.order]
