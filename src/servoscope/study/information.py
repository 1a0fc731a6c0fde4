"""Mutual information of the candidates: how much, in which order, and how much of it by chance."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.pipeline import FeatureTable
from servoscope.poses import DOFS
from servoscope.selection import (
    Candidates,
    OrderStability,
    Ranking,
    corrected_mutual_information,
    information_test,
    mutual_information,
    order_stability,
    pairwise_mutual_information,
    rank_ideal_point,
    rank_ideal_point_corrected,
    redundancy_bias,
)
from servoscope.study.feature_tables import CANDIDATES


@dataclass(frozen=True, eq=False)
class Assessment:
    """What mutual information says of the candidate features.

    Parameters
    ----------
    names : list of n_features str
    mutual_information : ndarray of shape (n_features, 6)
        [bits].
    rankings : dict
        The ideal-point ranking of every dof.
    stability : dict
        For every dof, how the order changes with the number of bins.
    null_level : float
        Mutual information that unrelated variables would show by chance, [bits].
    """

    names: list[str]
    mutual_information: NDArray[np.float64]
    rankings: dict[str, Ranking]
    stability: dict[str, OrderStability]
    null_level: float


def assess_features(
    table: FeatureTable,
    targets: NDArray[np.float64],
    samples: NDArray[np.intp],
    *,
    n_bins: int = 10,
    n_ranked: int = 24,
) -> Assessment:
    """Assess the candidate features of a table on the given samples.

    Parameters
    ----------
    table : FeatureTable
    targets : ndarray of shape (n_images, 6)
        Displacements, in `DOFS` order.
    samples : ndarray
        Indices of the images to assess on.
    n_bins : int
        Equal-width bins of every variable.
    n_ranked : int
        Features to rank for each dof.
    """
    candidates = table.columns(CANDIDATES)
    X, Y = table.values[np.ix_(samples, candidates)], targets[samples]
    relevance = mutual_information(X, Y, n_bins=n_bins)
    pairwise = pairwise_mutual_information(X, n_bins=n_bins)
    rankings = {
        dof: rank_ideal_point(relevance[:, i], pairwise, n_ranked) for i, dof in enumerate(DOFS)
    }
    stability = order_stability(X, Y, reference=n_bins, n_top=n_ranked)
    return Assessment(
        names=[table.names[i] for i in candidates],
        mutual_information=relevance,
        rankings=rankings,
        stability=dict(zip(DOFS, stability, strict=True)),
        null_level=(n_bins - 1) ** 2 / (2 * len(samples) * np.log(2)),
    )


def rankings_as_csv(assessments: Mapping[tuple[str, str], Assessment]) -> str:
    """The rankings of every protocol and displacement form, one row a selected feature."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(
        ("protocol", "displacement", "dof", "step", "feature", "relevance_bits", "redundancy_bits")
    )
    for unit, assessment in assessments.items():
        for dof, ranking in assessment.rankings.items():
            steps = zip(ranking.order, ranking.relevance, ranking.redundancy, strict=True)
            for step, (i, relevance, redundancy) in enumerate(steps, start=1):
                writer.writerow((*unit, dof, step, assessment.names[i], relevance, redundancy))
    return text.getvalue()


CORRECTION = "miller_madow"
"""Right for features that inform a dof and for those that do not; see `information_bias`."""


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
