"""Mutual information of the candidates with every dof, and the order it puts them in."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from servoscope.pipeline import FeatureTable
from servoscope.poses import DOFS
from servoscope.selection import (
    OrderStability,
    Ranking,
    mutual_information,
    order_stability,
    pairwise_mutual_information,
    rank_ideal_point,
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
