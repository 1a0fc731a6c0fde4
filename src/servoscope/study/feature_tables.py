"""The features of every family for one protocol and one displacement form."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

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
from servoscope.study.config import N_EIGENVECTORS
from servoscope.study.paper import FAMILIES, family_of

N_CANDIDATE_EIGENVECTORS = 35
"""Eigenfeatures that are candidates for selection; also the eigenvectors of family LFA 35."""

CANDIDATES = Recipe("moments+eigenfeatures+pose_covariance")
"""The features that selection chooses from: all but LFA, as in the paper."""


def study_table(values: NDArray[np.float64], names: Sequence[str]) -> FeatureTable:
    """The feature table of a study, whose families are known by the names of their features.

    Parameters
    ----------
    values : ndarray of shape (n_images, n_features)
    names : sequence of n_features str
        Moments, eigenfeatures ``e_00``, ..., ``pci_tx``, ..., and the LFA features as
        ``lfa35_tx_00``, ...
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

    Parameters
    ----------
    data : PoseImageSet
    moments : ndarray of shape (n_images, 24)
        Geometric moments, which need no fitting.
    basis : ImageBasis
        Eigenvectors of the training images, `N_EIGENVECTORS` at least.
    train : ndarray
        Indices of the training images.
    displacement : {"pivot", "camera"}
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
