"""Projections of the output of local feature analysis onto its covariance with the pose."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.utils import Tags

from servoscope.features.image_basis import ImageBasis, fitted_basis
from servoscope.features.image_transformer import ImageTransformer, target_names
from servoscope.features.pixel_blocks import project_images
from servoscope.features.pixels import ImageShape
from servoscope.processes import one_blas_thread

Array = NDArray[np.float64]


class LocalFeatureCovariance(ImageTransformer):
    """Projections of the LFA output onto its covariance with each degree of freedom.

    `LocalFeatureAnalysis` looks at this covariance for where it is largest and takes the output
    there; these features take the output everywhere, weighted with the covariance.

    Parameters
    ----------
    n_components : int
        Number of eigenvectors that the receptive fields are made of.
    image_shape : (height, width), optional
        What flat images are; 1 x n_pixels by default.
    basis : ImageBasis, optional
        Eigenvectors computed before, of which the first `n_components` are used.

    Attributes
    ----------
    components_ : ndarray of shape (n_targets, n_pixels)
        What images are projected onto.
    basis_ : ImageBasis
        The eigenvectors in use.
    image_shape_ : (height, width)
    n_features_in_ : int
        Pixels of an image.

    Raises
    ------
    InvalidInputError
        If there are fewer independent images than `n_components`, there are not as many
        displacements as images, an image is not of the size seen in `fit`, or a number is not
        finite.

    Notes
    -----
    Eq. 15-18 of [1]_: the output is ``y = K^T x`` with ``K = E diag(lambda^-1/2) E^T`` (eq. 17),
    its covariance with the displacements ``M = K^T X P`` (eq. 18, as `LocalFeatureAnalysis` has
    it but not scaled), and the features are ``M^T y``. ``K`` acts twice in them:

    ``M^T y = P^T X^T K K^T x = P^T X^T E diag(1 / lambda_i) E^T x``,

    images being columns. So they are the least-squares estimate of the displacement from the
    first eigenfeatures, the pseudo-inverse of the interaction matrix cut off after
    `n_components` eigenvectors where `WhitenedPoseCovariance` damps it.

    References
    ----------
    .. [1] G. Wells and C. Torras, "Assessing image features for vision-based robot positioning",
       Journal of Intelligent and Robotic Systems 30 (2001), 95-118.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> images = rng.integers(0, 256, (20, 8, 8), dtype=np.uint8)
    >>> delta_p = rng.uniform(-1, 1, (20, 6))
    >>> covariance = LocalFeatureCovariance(n_components=5).fit(images, delta_p)
    >>> covariance.transform(images).shape
    (20, 6)
    >>> covariance.get_feature_names_out()[[0, 5]]
    array(['pclfa_tx', 'pclfa_rz'], dtype=object)
    """

    _min_images = 2
    _min_pixels = 2

    def __init__(
        self,
        n_components: int = 85,
        image_shape: ImageShape | None = None,
        basis: ImageBasis | None = None,
    ) -> None:
        self.n_components = n_components
        self.image_shape = image_shape
        self.basis = basis

    def fit(self, X: Any, y: Any) -> LocalFeatureCovariance:
        """Compute the covariance of the LFA output with the displacements.

        Parameters
        ----------
        X : array of shape (n_images, height, width) or (n_images, height * width)
        y : array of shape (n_images, n_targets) or (n_images,)
            Displacement of each image from the reference, [m] and [rad], in `DOFS` order if
            there are six.

        Returns
        -------
        LocalFeatureCovariance
            Itself.
        """
        flat, delta_p = self._images_and_targets_to_fit(X, y)
        self.basis_ = fitted_basis(flat, self.n_components, self.image_shape_, self.basis)
        projections = project_images(flat, self.basis_.mean, self.basis_.components)
        centred = delta_p - delta_p.mean(axis=0)
        with one_blas_thread():
            weights = (projections.T @ centred) / self.basis_.eigenvalues[:, None]
            weights = weights.astype(self.basis_.components.dtype)
            self.components_ = weights.T @ self.basis_.components
        return self

    def transform(self, X: Any) -> Array:
        """Projections of the LFA output of images.

        Parameters
        ----------
        X : array of shape (n_images, height, width) or (n_images, height * width)

        Returns
        -------
        ndarray of shape (n_images, n_targets)
        """
        flat = self._images_to_transform(X)
        return project_images(flat, self.basis_.mean, self.components_)

    def _feature_names(self) -> list[str]:
        return [f"pclfa_{name}" for name in target_names(len(self.components_))]

    def __sklearn_tags__(self) -> Tags:
        tags = super().__sklearn_tags__()
        tags.target_tags.required = True
        tags.target_tags.multi_output = True
        return tags
