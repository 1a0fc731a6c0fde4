"""The leading eigenvectors of images, and eigenfeatures: projections onto them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import eigh

from servoscope.errors import InvalidInputError
from servoscope.features.image_sums import leading_eigenvectors
from servoscope.features.image_transformer import (
    ImageShape,
    LearnedProjection,
    check_finite,
    check_whole_number,
    flatten_images,
)
from servoscope.features.normalised_images import (
    extremes_made_positive,
    mean_and_gram,
    rounding_variance,
    sum_images,
)
from servoscope.processes import one_blas_thread
from servoscope.storage.stacks import Stack


@dataclass(frozen=True, eq=False)
class ImageBasis:
    """Mean and leading eigenvectors of brightness-normalised images.

    Computed once by `compute_image_basis`, it can be given to every estimator that needs
    eigenvectors. Its arrays are read-only, so copies of such an estimator share it.

    Attributes
    ----------
    image_shape : (height, width)
        [px].
    eigenvalues : ndarray of shape (n_components,)
        Of ``X X^T`` (eq. 10), not divided by the number of images; largest first.
    mean : ndarray of shape (n_pixels,)
    components : ndarray of shape (n_components, n_pixels)
        Unit eigenvectors as rows; the entry of largest magnitude is positive.
    """

    image_shape: ImageShape
    eigenvalues: NDArray[np.float64] = field(repr=False)
    mean: NDArray[np.float64] = field(repr=False)
    components: NDArray[Any] = field(repr=False)

    def __post_init__(self) -> None:
        for array in (self.eigenvalues, self.mean, self.components):
            array.setflags(write=False)

    def __deepcopy__(self, memo: dict[int, Any]) -> ImageBasis:
        return self

    def __len__(self) -> int:
        return len(self.eigenvalues)

    def leading(self, n_components: int) -> ImageBasis:
        """The first eigenvectors only, sharing memory.

        Raises
        ------
        InvalidInputError
            If there are not so many.
        """
        check_whole_number("n_components", n_components, 1)
        if n_components > len(self):
            raise InvalidInputError(
                f"n_components is {n_components}, but the basis has {len(self)} eigenvectors; "
                "ask for fewer or compute a larger basis."
            )
        return ImageBasis(
            self.image_shape,
            self.eigenvalues[:n_components],
            self.mean,
            self.components[:n_components],
        )


def compute_image_basis(
    images: Any, n_components: int, image_shape: ImageShape | None = None
) -> ImageBasis:
    """Mean and leading eigenvectors of images, normalised for brightness.

    Parameters
    ----------
    images : array of shape (n_images, height, width) or (n_images, height * width)
        Or a `servoscope.storage.stacks.Stack` of them, see `leading_eigenvectors`.
    n_components : int
    image_shape : (height, width), optional
        What flat images are; 1 x n_pixels by default.

    Returns
    -------
    ImageBasis

    Raises
    ------
    InvalidInputError
        If the images, centred, have fewer independent ones than `n_components`.

    Notes
    -----
    Eq. 8-11 of the paper. ``X X^T`` is n_pixels x n_pixels; the snapshot method takes the
    eigenvectors ``v`` of the n_images x n_images matrix ``X^T X`` instead, which has the same
    eigenvalues, and ``e = X v / sqrt(lambda)``. Products of uint8 images are float32, summed in
    float64 over blocks of pixels.

    Examples
    --------
    >>> images = np.random.default_rng(0).integers(0, 256, (20, 8, 8), dtype=np.uint8)
    >>> basis = compute_image_basis(images, n_components=3)
    >>> basis.components.shape, basis.leading(2).eigenvalues.shape
    ((3, 64), (2,))
    """
    check_whole_number("n_components", n_components, 1)
    flat, image_shape = flatten_images(images, image_shape)
    if not isinstance(flat, Stack):
        flat = np.asarray(flat)
        check_finite(flat)
    if n_components >= len(flat):
        raise InvalidInputError(
            f"{n_components} eigenvectors need at least {n_components + 1} images, got "
            f"{len(flat)} (n_samples = {len(flat)}); lower n_components or take more images."
        )
    if isinstance(flat, Stack):
        mean, eigenvalues, found = leading_eigenvectors(flat, n_components)
        return ImageBasis(image_shape, eigenvalues, mean, extremes_made_positive(found))
    mean, gram = mean_and_gram(flat)
    eigenvalues, vectors = _leading_eigenpairs(flat, gram, n_components)
    components = sum_images(flat, mean, vectors / np.sqrt(eigenvalues))
    return ImageBasis(image_shape, eigenvalues, mean, extremes_made_positive(components))


def fitted_basis(
    flat: NDArray[Any], n_components: int, image_shape: ImageShape, basis: ImageBasis | None
) -> ImageBasis:
    """The leading eigenvectors of a basis that was given, or else of the images."""
    if basis is None:
        return compute_image_basis(flat, n_components, image_shape)
    if basis.image_shape != image_shape:
        raise InvalidInputError(
            "The basis is of images of {} x {} (height x width), but the images are of "
            "{} x {}; compute the basis from images of this size.".format(
                *basis.image_shape, *image_shape
            )
        )
    return basis.leading(n_components)


def _leading_eigenpairs(
    flat: NDArray[Any], gram: NDArray[np.float64], n_components: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    n_images = len(gram)
    with one_blas_thread():
        eigenvalues, vectors = eigh(gram, subset_by_index=[n_images - n_components, n_images - 1])
    eigenvalues, vectors = eigenvalues[::-1], vectors[:, ::-1]
    n_independent = int(np.count_nonzero(eigenvalues > rounding_variance(flat, eigenvalues[0])))
    if n_independent < n_components:
        raise InvalidInputError(
            f"{n_components} eigenvectors need {n_components + 1} independent images, but the "
            f"{n_images} images, normalised and centred, have only {n_independent} directions in "
            "which they vary; lower n_components or take images that differ more."
        )
    return eigenvalues.copy(), vectors


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

    Raises
    ------
    InvalidInputError
        If there are fewer independent images than `n_components`.

    Notes
    -----
    Eq. 8-12 of the paper: each image is divided by its Euclidean length (a black one stays black),
    the mean of the training images is subtracted, and what is left is projected.

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

    def _learn(self, flat: NDArray[Any], targets: Any) -> None:
        self.basis_ = fitted_basis(flat, self.n_components, self.image_shape_, self.basis)

    def to_arrays(self) -> dict[str, NDArray]:
        """What `transform` needs, as plain arrays."""
        return {**super().to_arrays(), "eigenvalues": self.eigenvalues_}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, ArrayLike]) -> Self:
        """Features as those that `to_arrays` was called on."""
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
