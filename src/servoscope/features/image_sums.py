"""Sums over brightness-normalised images that are read block by block, and what follows of them."""

from __future__ import annotations

from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh, qr

from servoscope.errors import InvalidInputError
from servoscope.features.normalised_images import brightness_norms
from servoscope.processes import one_blas_thread
from servoscope.storage.stacks import Stack, blocks_of

Array = NDArray[np.float64]

OVERSAMPLED = 20
"""Directions that are followed beside those that are wanted."""

PRECISION = 1e-9
"""Eigenvalues are found to within this share of the largest."""

MOST_PASSES = 20
"""Over all images, for eigenvectors."""


class ImageStatistics(NamedTuple):
    """What `ImageSums` are of.

    Parameters
    ----------
    n_images : int
    mean : ndarray of shape (n_pixels,)
        Of the normalised images.
    target_products : ndarray of shape (n_targets, n_pixels)
        Sum of the images about their mean, times each target.
    products : ndarray of shape (n_pixels, n_directions)
        Of ``X^T X`` with the directions, X being the images about their mean, a row each.
    """

    n_images: int
    mean: Array
    target_products: Array
    products: Array


class ImageSums:
    """Sums over images, each divided by its length (after eq. 8 of the paper), in float64.

    Sums of blocks are merged in any order, with the same result but for rounding.

    Parameters
    ----------
    n_pixels : int
    n_targets : int
    directions : ndarray of shape (n_pixels, n_directions), optional

    Examples
    --------
    >>> images = np.random.default_rng(0).integers(0, 256, (30, 64), dtype=np.uint8)
    >>> first, second = ImageSums(64), ImageSums(64)
    >>> first.update(images[:10]).merge(second.update(images[10:])).finalize().mean.shape
    (64,)
    """

    def __init__(self, n_pixels: int, n_targets: int = 0, directions: Array | None = None) -> None:
        self.directions = np.empty((n_pixels, 0)) if directions is None else directions
        self.n_images = 0
        self._total, self._of_targets = np.zeros(n_pixels), np.zeros(n_targets)
        self._with_targets = np.zeros((n_targets, n_pixels))
        self._products = np.zeros(self.directions.shape)

    def update(self, flat: NDArray[Any], targets: Array | None = None) -> Self:
        """Add a block of images (n, n_pixels), with targets (n, n_targets)."""
        norms = brightness_norms(flat)
        images = flat / np.where(norms > 0, norms, 1.0)[:, None]
        targets = np.empty((len(flat), 0)) if targets is None else targets
        with one_blas_thread():
            self._total += images.sum(axis=0)
            self._of_targets += targets.sum(axis=0)
            self._with_targets += targets.T @ images
            self._products += images.T @ (images @ self.directions)
        self.n_images += len(flat)
        return self

    def merge(self, other: ImageSums) -> Self:
        """Add the sums over other images, with the same directions."""
        self.n_images += other.n_images
        self._total += other._total
        self._of_targets += other._of_targets
        self._with_targets += other._with_targets
        self._products += other._products
        return self

    def finalize(self) -> ImageStatistics:
        """The statistics of all images that were added.

        Raises
        ------
        InvalidInputError
            If there are none.
        """
        if not self.n_images:
            raise InvalidInputError("Statistics need images, and none was added.")
        mean = self._total / self.n_images
        with one_blas_thread():
            along = mean @ self.directions
        return ImageStatistics(
            self.n_images,
            mean,
            self._with_targets - self._of_targets[:, None] * mean,
            self._products - self.n_images * np.outer(mean, along),
        )


def sum_over(
    flat: Stack, targets: Array | None = None, directions: Array | None = None
) -> ImageStatistics:
    """Statistics of the images of a stack, (n, n_pixels), read once."""
    n_targets = 0 if targets is None else targets.shape[1]
    sums, start = ImageSums(flat.shape[1], n_targets, directions), 0
    for block in blocks_of(flat):
        rows = slice(start, start + len(block))
        sums.update(block, None if targets is None else targets[rows])
        start += len(block)
    return sums.finalize()


def leading_eigenvectors(flat: Stack, n_components: int) -> tuple[Array, Array, Array]:
    """Mean, leading eigenvalues and eigenvectors of ``X^T X`` of the images of a stack.

    Returns
    -------
    mean : ndarray of shape (n_pixels,)
    eigenvalues : ndarray of shape (n_components,)
        Largest first.
    components : ndarray of shape (n_components, n_pixels)

    Raises
    ------
    InvalidInputError
        If the images vary in fewer directions, or the eigenvectors are not found.

    Notes
    -----
    A randomised range finder [1]_ with subspace iteration, one pass over the images for each step.
    An eigenvalue is as near to the one that is found as the length of the residual
    ``X^T X v - lambda v`` (Weyl), whatever the range finder missed within it; the iteration ends
    when that is under `PRECISION` of the largest for all that are wanted.

    References
    ----------
    .. [1] N. Halko, P. Martinsson and J. Tropp, "Finding structure with randomness", SIAM Review 53
       (2011), 217-288, algorithm 4.4.
    """
    n_images, n_pixels = flat.shape
    n_directions = min(n_components + OVERSAMPLED, n_pixels, n_images)
    Q = np.random.default_rng(0).normal(size=(n_pixels, n_directions))
    with one_blas_thread():
        for _ in range(MOST_PASSES):
            Q = qr(Q, mode="economic", check_finite=False)[0]
            found = sum_over(flat, directions=Q)
            values, vectors = eigh(Q.T @ found.products)
            values, vectors = values[::-1][:n_components], vectors[:, ::-1][:, :n_components]
            components = Q @ vectors
            residuals = np.linalg.norm(found.products @ vectors - components * values, axis=0)
            if residuals.max() <= PRECISION * values[0]:
                break
            Q = found.products
        else:
            raise InvalidInputError(
                f"{n_components} eigenvectors are not found in {MOST_PASSES} passes over the "
                "images; ask for fewer."
            )
    n_found = int(np.count_nonzero(values > PRECISION * values[0]))
    if n_found < n_components:
        raise InvalidInputError(
            f"{n_components} eigenvectors were wanted, but the {n_images} images, normalised and "
            f"centred, vary in {n_found} directions only; lower n_components."
        )
    return found.mean, values.copy(), components.T
