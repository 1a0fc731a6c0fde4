"""The features of every family, and the mutual information of the candidates: order and chance."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.data.images import PoseImageSet
from servoscope.features import (
    Eigenfeatures,
    GeometricMoments,
    ImageBasis,
    LocalFeatureAnalysis,
    PoseImageCovariance,
)
from servoscope.pipeline import FeatureTable, Recipe
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
from servoscope.study.paper import FAMILIES, N_EIGENVECTORS, family_of

N_CANDIDATE_EIGENVECTORS = 35
"""Eigenfeatures that are candidates for selection; also the eigenvectors of family LFA 35."""

CANDIDATES = Recipe("moments+eigenfeatures+pose_covariance")
"""The features that selection chooses from: all but LFA, as in the paper."""


def study_table(values: NDArray[np.float64], names: Sequence[str]) -> FeatureTable:
    """The feature table of a study, whose families are known by the names of their features:

    moments, eigenfeatures ``e_00``, ..., ``pci_tx``, ..., and the LFA features as ``lfa35_tx_00``,
    ...
    """
    families = tuple(str(FAMILIES[family_of(name)].recipe.features) for name in names)
    return FeatureTable(values, tuple(names), families)


@dataclass(frozen=True, eq=False)
class FeaturePictures:
    """What the study's figures show of the families, float32.

    ``eigenvectors`` (n, height, width); ``pci``, ``covariance``, ``filtered`` and ``lfa``
    (6, height, width): the PCI vectors, the pose-LFA covariance from 85 eigenvectors, the same
    filtered, and the first LFA vector chosen for each dof; ``locations`` (6, 12, 2): row and
    column of the chosen LFA vectors.
    """

    eigenvectors: NDArray[np.float32]
    pci: NDArray[np.float32]
    covariance: NDArray[np.float32]
    filtered: NDArray[np.float32]
    lfa: NDArray[np.float32]
    locations: NDArray[np.intp]


def compute_feature_table(
    data: PoseImageSet,
    moments: NDArray[np.float64],
    basis: ImageBasis,
    train: NDArray[np.intp],
    displacement: str,
) -> tuple[FeatureTable, FeaturePictures]:
    """Features of every image, with all that is fitted taken from the training images alone.

    Moments need no fitting; the basis is of the training images, of `N_EIGENVECTORS` at least.
    """
    images, targets = data.images[train], data.delta_p(displacement)[train]
    window = lfa_window(data.image_shape)
    families = {
        "e": Eigenfeatures(N_CANDIDATE_EIGENVECTORS, basis=basis),
        "pci": PoseImageCovariance(),
        "lfa35": LocalFeatureAnalysis(N_CANDIDATE_EIGENVECTORS, window=window, basis=basis),
        "lfa85": LocalFeatureAnalysis(N_EIGENVECTORS, window=window, basis=basis),
    }
    columns = [moments]
    names = list(GeometricMoments().fit(images).get_feature_names_out())
    for family, transformer in families.items():
        columns.append(transformer.fit(images, targets).transform(data.images))
        for name in transformer.get_feature_names_out():
            names.append(name.replace("lfa", family) if family.startswith("lfa") else name)
    table = study_table(np.column_stack(columns).astype(float), names)
    pictures = _pictures(data.image_shape, families["e"], families["pci"], families["lfa85"])
    return table, pictures


def lfa_window(image_shape: tuple[int, int]) -> int:
    """Side of the LFA subwindows [px]: the paper's 12 for images of 256, in proportion for others.

    Examples
    --------
    >>> lfa_window((256, 256)), lfa_window((64, 64)), lfa_window((480, 640))
    (12, 4, 22)
    """
    return max(2, 2 * round(6 * min(image_shape) / 256))


def _pictures(
    shape: tuple[int, int],
    eigen: Eigenfeatures,
    pci: PoseImageCovariance,
    lfa: LocalFeatureAnalysis,
) -> FeaturePictures:
    first = [lfa.receptive_field(*lfa.locations_[dof, 0]) for dof in range(len(DOFS))]
    return FeaturePictures(
        eigenvectors=eigen.components_[:12].reshape(-1, *shape).astype(np.float32),
        pci=pci.components_.reshape(-1, *shape).astype(np.float32),
        covariance=lfa.covariance_.astype(np.float32),
        filtered=lfa.filtered_.astype(np.float32),
        lfa=np.stack(first).astype(np.float32),
        locations=lfa.locations_,
    )


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
    """Assess the candidate features of a table on the samples of some images, for each of 6
    targets.
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
    """What chance adds to the information, the redundancy and the order of an assessment, as plain
    values.

    ``mi_corrected[feature][dof]`` is in bits, by ``mi_correction``.
    ``mi_significant[feature][dof]`` are the findings of which at most 5 % are wrong, by the null
    distribution ``mi_null``: shifts of the sequence where images, in the order of time, resemble
    their neighbours, else chi-square. ``redundancy_bias[dof]`` has for every step of the ranking
    its ``redundancy``, how much of that is ``bias``, which is too little where there are few
    images, and what as many ``unrelated`` features would show. ``table2_corrected[dof]`` are names
    in the order of the corrected ideal-point rule.
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
