"""Directions of images that covary with the pose: pose-image covariance, partial least squares."""

from __future__ import annotations

from itertools import combinations_with_replacement
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from servoscope.errors import InvalidInputError
from servoscope.features.image_sums import sum_over
from servoscope.features.image_transformer import (
    ImageShape,
    LearnedProjection,
    check_whole_number,
    target_names,
)
from servoscope.features.normalised_images import (
    extremes_made_positive,
    map_blocks,
    mean_and_gram,
    rounding_variance,
    sum_images,
    working_dtype,
)
from servoscope.processes import one_blas_thread
from servoscope.storage.stacks import Stack


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

    Notes
    -----
    Eq. 13-14 of the paper. As printed, ``M = X P^T`` does not conform, X being n_pixels x n_images
    and P n_images x 6; ``X P`` is meant. Here images are rows, so it is ``X.T @ delta_p``. The
    displacements start at the reference and are not centred; as the images are, centring them
    would change nothing.

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

    def _learn(self, flat: NDArray[Any], targets: Array) -> None:
        if isinstance(flat, Stack):
            found = sum_over(flat, targets)
            self.mean_, self.components_ = found.mean, found.target_products
            return
        self.mean_ = np.empty(flat.shape[1])
        self.components_ = np.empty((targets.shape[1], flat.shape[1]), working_dtype(flat))
        P = targets.astype(self.components_.dtype)
        for pixels, block_mean, part in map_blocks(lambda block, _: P.T @ block, flat):
            self.mean_[pixels] = block_mean
            self.components_[:, pixels] = part

    def _feature_names(self) -> list[str]:
        return [f"pci_{name}" for name in target_names(len(self.components_))]


Array = NDArray[np.float64]


class PoseLeastSquares(LearnedProjection):
    """Projections of images onto the directions that covary most with the displacement.

    Parameters
    ----------
    n_components : int
        Number of directions.
    products : bool
        Whether directions are sought that covary with the products of two displacements as well.
    image_shape : (height, width), optional
        What flat images are; 1 x n_pixels by default.

    Attributes
    ----------
    components_ : ndarray of shape (n_components, n_pixels)
        Unit vectors that images are projected onto; the entry of largest magnitude is positive.
    mean_ : ndarray of shape (n_pixels,)
        Mean of the normalised training images.

    Raises
    ------
    InvalidInputError
        If fewer than `n_components` directions covary with the displacements.

    Notes
    -----
    SIMPLS [1]_ on images normalised as in eq. 9 of the paper. Each direction is the one whose
    projection covaries most with a combination of the displacements, among those whose
    projections are uncorrelated with the ones before. The first directions span what the
    pose-image covariance vectors (eq. 13) do; the others, unlike eigenvectors, are in order of
    what they add about the pose. Displacements are scaled to unit variance, so that neither units
    nor ranges matter. Its sums over pixels are only two: the inner products of the images, in
    whose eigenvectors the directions are found, and the directions as sums of images.

    References
    ----------
    .. [1] S. de Jong, "SIMPLS: an alternative approach to partial least squares regression",
       Chemometrics and Intelligent Laboratory Systems 18 (1993), 251-263.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> images = rng.integers(0, 256, (30, 8, 8), dtype=np.uint8)
    >>> delta_p = rng.uniform(-1, 1, (30, 6))
    >>> pls = PoseLeastSquares(n_components=10).fit(images, delta_p)
    >>> features = pls.transform(images)
    >>> np.allclose(np.corrcoef(features.T), np.eye(10), atol=1e-4)
    True
    >>> pls.get_feature_names_out()[[0, 9]]
    array(['pls_00', 'pls_09'], dtype=object)
    """

    def __init__(
        self,
        n_components: int = 20,
        products: bool = True,
        image_shape: ImageShape | None = None,
    ) -> None:
        self.n_components = n_components
        self.products = products
        self.image_shape = image_shape

    def _check_parameters(self) -> None:
        check_whole_number("n_components", self.n_components, 1)

    def _learn(self, flat: NDArray[Any], targets: Array) -> None:
        targets = _unit_columns(centred_targets(_unit_columns(targets), self.products))
        if isinstance(flat, Stack):
            self.mean_, components = _streamed_directions(flat, targets, self.n_components)
        else:
            self.mean_, gram = mean_and_gram(flat)
            weights = _direction_weights(flat, gram, targets, self.n_components)
            components = sum_images(flat, self.mean_, weights)
        components /= np.linalg.norm(components, axis=1, keepdims=True)
        self.components_ = extremes_made_positive(components)

    def _feature_names(self) -> list[str]:
        return [f"pls_{i:02d}" for i in range(len(self.components_))]


def find_pls_directions(X: Array, Y: Array, n_components: int) -> Array:
    """Directions (n_values, n_components) of partial least squares by SIMPLS; see
    `PoseLeastSquares`. `X` (n, n_values) and `Y` (n, n_targets) are centred, and ``X @ directions``
    has orthonormal columns.
    """
    covariance = X.T @ Y
    least = 1e-9 * np.linalg.norm(covariance)
    directions = np.zeros((X.shape[1], n_components))
    loadings = np.zeros((X.shape[1], n_components))
    for i in range(n_components):
        direction = covariance @ eigh(covariance.T @ covariance)[1][:, -1]
        score = X @ direction
        length = np.linalg.norm(score)
        if np.linalg.norm(covariance) <= least or length == 0:
            raise _too_few_directions(n_components, i)
        directions[:, i] = direction / length
        loading = X.T @ (score / length)
        for _ in range(2):  # once more for what rounding left
            loading -= loadings @ (loadings.T @ loading)
        loadings[:, i] = loading / np.linalg.norm(loading)
        covariance -= np.outer(loadings[:, i], loadings[:, i] @ covariance)
    return directions


def _streamed_directions(flat: Stack, targets: Array, n_components: int) -> tuple[Array, Array]:
    """Mean of the images of a stack, and the directions of `find_pls_directions` in them.

    Each direction takes one pass over the images.
    """
    found = sum_over(flat, targets)
    covariance = found.target_products.T
    least = 1e-9 * np.linalg.norm(covariance)
    directions, loadings = (np.zeros((flat.shape[1], n_components)) for _ in range(2))
    with one_blas_thread():
        for i in range(n_components):
            direction = covariance @ eigh(covariance.T @ covariance)[1][:, -1]
            products = sum_over(flat, directions=direction[:, None]).products[:, 0]
            squared = float(direction @ products)
            if np.linalg.norm(covariance) <= least or squared <= 0:
                raise _too_few_directions(n_components, i)
            directions[:, i] = direction
            loading = products / squared**0.5
            for _ in range(2):  # once more for what rounding left
                loading -= loadings @ (loadings.T @ loading)
            loadings[:, i] = loading / np.linalg.norm(loading)
            covariance -= np.outer(loadings[:, i], loadings[:, i] @ covariance)
    return found.mean, directions.T


def _too_few_directions(n_wanted: int, n_found: int) -> InvalidInputError:
    return InvalidInputError(
        f"{n_wanted} directions that covary with the displacements were wanted, but there are only "
        f"{n_found}; lower n_components or take more images."
    )


def centred_targets(delta_p: Array, products: bool) -> Array:
    """Displacements about their mean and, if asked for, the products of two of them about theirs.

    The products are the second-order terms of how an image depends on its pose.

    Examples
    --------
    >>> centred_targets(np.array([[1.0], [2.0], [6.0]]), products=True)
    array([[-2.        , -0.66666667],
           [-1.        , -3.66666667],
           [ 3.        ,  4.33333333]])
    """
    centred = delta_p - delta_p.mean(axis=0)
    if not products:
        return centred
    pairs = combinations_with_replacement(range(centred.shape[1]), 2)
    terms = np.stack([centred[:, i] * centred[:, j] for i, j in pairs], axis=1)
    return np.hstack([centred, terms - terms.mean(axis=0)])


def _direction_weights(flat: NDArray[Any], gram: Array, targets: Array, n_components: int) -> Array:
    """What images are weighted with in each direction."""
    with one_blas_thread():
        eigenvalues, vectors = eigh(gram)
        varying = eigenvalues > rounding_variance(flat, eigenvalues[-1])
        lengths, vectors = np.sqrt(eigenvalues[varying]), vectors[:, varying]
        directions = find_pls_directions(vectors * lengths, targets, n_components)
        return vectors @ (directions / lengths[:, None])


def _unit_columns(values: Array) -> Array:
    """Columns about their mean in units of their standard deviation; 0 for one without any."""
    centred = values - values.mean(axis=0)
    deviations = values.std(axis=0)
    moving = deviations > 1e-12 * np.abs(values).max(axis=0, initial=0.0)
    return np.where(moving, centred / np.where(moving, deviations, 1.0), 0.0)
