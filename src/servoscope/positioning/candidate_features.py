"""The features that are candidates for the networks of positioning."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from servoscope.features import Eigenfeatures, GeometricMoments, PoseImageCovariance
from servoscope.positioning.linear_features import FeaturePool, Projection
from servoscope.positioning.pose_vectors import compute_pose_vectors, pose_vector_names

PAPER_PREPARATIONS = ("moments", "grey")
NORMALISED_PREPARATIONS = ("local", "gradient", "orientation")

N_EIGENFEATURES, N_NORMALISED_EIGENFEATURES = 35, 24

Prepared = dict[str, NDArray[np.float32]]


def fit_paper_pool(prepared: Prepared, delta_p: NDArray[np.float64]) -> FeaturePool:
    """The paper's 65 features: moments, eigenfeatures and pose-image covariance.

    Parameters
    ----------
    prepared : dict of ndarray of shape (n, n_copies, n_values)
        Training images as ``moments`` and ``grey``; of the copies the first one counts.
    delta_p : ndarray of shape (n, 6)
        In units of the range.
    """
    values = prepared["moments"].shape[-1]
    names = GeometricMoments().fit(np.zeros((1, 2, 2))).get_feature_names_out().tolist()
    moments = Projection(np.zeros(values, np.float32), np.eye(values, dtype=np.float32), (*names,))
    grey = _image_vectors(prepared["grey"][:, 0], delta_p, N_EIGENFEATURES, "")
    return FeaturePool({"moments": moments, "grey": grey})


def fit_wide_pool(prepared: Prepared, delta_p: NDArray[np.float64]) -> FeaturePool:
    """The paper's 65 features, and those of normalised images.

    Of each normalised form of the image: eigenfeatures, pose-image covariance, and pose vectors,
    which are computed from the disturbed copies as well.

    Parameters
    ----------
    prepared : dict of ndarray of shape (n, n_copies, n_values)
        Training images in all preparations, the undisturbed copy first.
    delta_p : ndarray of shape (n, 6)
        In units of the range.
    """
    projections = dict(fit_paper_pool(prepared, delta_p).projections)
    for name in NORMALISED_PREPARATIONS:
        copies = prepared[name]
        vectors = _image_vectors(copies[:, 0], delta_p, N_NORMALISED_EIGENFEATURES, f"{name}_")
        rows = copies.reshape(-1, copies.shape[-1])
        pose = compute_pose_vectors(rows, np.repeat(delta_p, copies.shape[1], axis=0))
        projections[name] = Projection(
            vectors.mean,
            np.concatenate([vectors.components, pose]),
            (*vectors.names, *(f"{name}_{vector}" for vector in pose_vector_names())),
        )
    return FeaturePool(projections)


def _image_vectors(
    images: NDArray[np.float32], delta_p: NDArray[np.float64], n_components: int, prefix: str
) -> Projection:
    """Eigenfeatures and pose-image covariance of images of unit length."""
    n_components = min(n_components, len(images) - 1, images.shape[1] - 1)
    eigenfeatures = Eigenfeatures(n_components).fit(images)
    covariance = PoseImageCovariance().fit(images, delta_p)
    components = [eigenfeatures.components_, covariance.components_]
    names = [*eigenfeatures.get_feature_names_out(), *covariance.get_feature_names_out()]
    return Projection(
        eigenfeatures.mean_.astype(np.float32),
        np.concatenate(components).astype(np.float32),
        tuple(prefix + name for name in names),
    )
