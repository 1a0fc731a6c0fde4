"""Pose-image covariance: images that say how brightness varies with each degree of freedom."""

from __future__ import annotations

from typing import Any

import numpy as np

from servoscope.features.image_transformer import target_names
from servoscope.features.learned_projection import LearnedProjection
from servoscope.features.pixel_blocks import map_blocks, working_dtype
from servoscope.features.pixels import ImageShape


class PoseImageCovariance(LearnedProjection):
    """Projections of images onto the covariance of the training images with their poses.

    Parameters
    ----------
    image_shape : (height, width), optional
        What flat images are; 1 x n_pixels by default.

    Attributes
    ----------
    components_ : ndarray of shape (n_targets, n_pixels)
        One pose-image covariance vector for each column of the displacements.
    mean_ : ndarray of shape (n_pixels,)
        Mean of the normalised training images.
    image_shape_ : (height, width)
    n_features_in_ : int
        Pixels of an image.

    Raises
    ------
    InvalidInputError
        If there are not as many displacements as images, an image is not of the size seen in
        `fit`, or a number is not finite.

    Notes
    -----
    Eq. 13-14 of [1]_. As printed, ``M = X P^T`` does not conform, X being n_pixels x n_images
    and P n_images x 6; ``X P`` is meant. Here images are rows, so it is ``X.T @ delta_p``. The
    displacements start at the reference and are not centred; as the images are, centring them
    would change nothing.

    References
    ----------
    .. [1] G. Wells and C. Torras, "Assessing image features for vision-based robot positioning",
       Journal of Intelligent and Robotic Systems 30 (2001), 95-118.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> images = rng.integers(0, 256, (20, 8, 8), dtype=np.uint8)
    >>> delta_p = rng.uniform(-1, 1, (20, 6))
    >>> pci = PoseImageCovariance().fit(images, delta_p)
    >>> pci.transform(images).shape
    (20, 6)
    >>> pci.get_feature_names_out()[[0, 5]]
    array(['pci_tx', 'pci_rz'], dtype=object)
    """

    def __init__(self, image_shape: ImageShape | None = None) -> None:
        self.image_shape = image_shape

    def fit(self, X: Any, y: Any) -> PoseImageCovariance:
        """Compute the covariance of images with displacements.

        Parameters
        ----------
        X : array of shape (n_images, height, width) or (n_images, height * width)
        y : array of shape (n_images, n_targets) or (n_images,)
            Displacement of each image from the reference, [m] and [rad], in `DOFS` order if
            there are six.

        Returns
        -------
        PoseImageCovariance
            Itself.
        """
        flat, delta_p = self._images_and_targets_to_fit(X, y)
        self.mean_ = np.empty(flat.shape[1])
        self.components_ = np.empty((delta_p.shape[1], flat.shape[1]), working_dtype(flat))
        P = delta_p.astype(self.components_.dtype)
        for pixels, block_mean, part in map_blocks(lambda block, _: P.T @ block, flat):
            self.mean_[pixels] = block_mean
            self.components_[:, pixels] = part
        return self

    def _feature_names(self) -> list[str]:
        return [f"pci_{name}" for name in target_names(len(self.components_))]
