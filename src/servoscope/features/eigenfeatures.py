"""Eigenfeatures: projections of images onto their leading eigenvectors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.errors import InvalidInputError
from servoscope.features.image_basis import ImageBasis, fitted_basis
from servoscope.features.learned_projection import LearnedProjection
from servoscope.features.pixels import ImageShape


class Eigenfeatures(LearnedProjection):
    """Projections of images onto the leading eigenvectors of the training images.

    Parameters
    ----------
    n_components : int
        Number of eigenvectors.
    image_shape : (height, width), optional
        What flat images are; 1 x n_pixels by default.
    basis : ImageBasis, optional
        Eigenvectors computed before, of which the first `n_components` are used; `fit` then
        only checks that the images are of their size.

    Attributes
    ----------
    basis_ : ImageBasis
        The eigenvectors in use.
    image_shape_ : (height, width)
    n_features_in_ : int
        Pixels of an image.

    Raises
    ------
    InvalidInputError
        If there are fewer independent images than `n_components`, an image is not of the size
        seen in `fit`, or a pixel is not finite.

    Notes
    -----
    Eq. 8-12 of [1]_: each image is divided by its Euclidean length (a black one stays black),
    the mean of the training images is subtracted, and what is left is projected.

    References
    ----------
    .. [1] G. Wells and C. Torras, "Assessing image features for vision-based robot positioning",
       Journal of Intelligent and Robotic Systems 30 (2001), 95-118.

    Examples
    --------
    >>> images = np.random.default_rng(0).integers(0, 256, (20, 8, 8), dtype=np.uint8)
    >>> eigenfeatures = Eigenfeatures(n_components=3).fit(images)
    >>> eigenfeatures.transform(images).shape
    (20, 3)
    >>> eigenfeatures.get_feature_names_out()
    array(['e_00', 'e_01', 'e_02'], dtype=object)
    """

    _is_supervised = False

    def __init__(
        self,
        n_components: int = 35,
        image_shape: ImageShape | None = None,
        basis: ImageBasis | None = None,
    ) -> None:
        self.n_components = n_components
        self.image_shape = image_shape
        self.basis = basis

    def fit(self, X: Any, y: Any = None) -> Eigenfeatures:
        """Compute the eigenvectors of images.

        Parameters
        ----------
        X : array of shape (n_images, height, width) or (n_images, height * width)
        y : ignored

        Returns
        -------
        Eigenfeatures
            Itself.
        """
        flat = self._images_to_fit(X)
        self.basis_ = fitted_basis(flat, self.n_components, self.image_shape_, self.basis)
        return self

    def to_arrays(self) -> dict[str, NDArray]:
        """What `transform` needs, as plain arrays."""
        return {**super().to_arrays(), "eigenvalues": self.eigenvalues_}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, ArrayLike]) -> Self:
        """Features as those that `to_arrays` was called on.

        Raises
        ------
        InvalidInputError
            If an array is missing or the sizes disagree.
        """
        features = super().from_arrays(arrays)
        eigenvalues = np.asarray(arrays.get("eigenvalues", ()), dtype=np.float64)
        if len(eigenvalues) != len(features.components_):
            raise InvalidInputError(
                f"{len(features.components_)} eigenvectors need as many eigenvalues, got "
                f"{len(eigenvalues)}."
            )
        features.basis_ = replace(features.basis_, eigenvalues=eigenvalues)
        return features

    @property
    def components_(self) -> NDArray[Any]:
        """Unit eigenvectors, of shape (n_components, n_pixels)."""
        return self.basis_.components

    @property
    def eigenvalues_(self) -> NDArray[np.float64]:
        """Eigenvalues of ``X X^T``, largest first, of shape (n_components,)."""
        return self.basis_.eigenvalues

    @property
    def mean_(self) -> NDArray[np.float64]:
        """Mean of the normalised training images, of shape (n_pixels,)."""
        return self.basis_.mean

    def _restore(self, mean: NDArray, components: NDArray) -> None:
        self.n_components = len(components)
        eigenvalues = np.zeros(len(components))
        self.basis_ = ImageBasis(self.image_shape_, eigenvalues, mean, components)

    def _feature_names(self) -> list[str]:
        return [f"e_{i:02d}" for i in range(len(self.basis_))]
