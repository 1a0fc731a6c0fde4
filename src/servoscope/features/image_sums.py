"""Sums over brightness-normalised images that are read block by block, and what follows of them."""

from __future__ import annotations

from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh, qr

from servoscope.arrays import as_numbers
from servoscope.errors import InvalidInputError
from servoscope.features.normalised_images import brightness_norms
from servoscope.processes import one_blas_thread
from servoscope.storage.stacks import Stack, blocks_of

Array = NDArray[np.float64]

OVERSAMPLED = 20
"""Directions that are followed beside those that are wanted."""

PRECISION = 1e-9
"""Eigenvalues are found to within this share of the largest."""

ROUNDING = 1e-14
"""Eigenvalues below this share of the number of images are rounding."""

MOST_PASSES, MOST_BLOCKS = 40, 4
"""Over all images, for eigenvectors; and blocks of directions that are kept meanwhile."""


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
        if n_pixels < 1 or n_targets < 0:
            raise InvalidInputError(
                f"Sums are over 1 pixel or more and 0 targets or more, got {n_pixels} and "
                f"{n_targets}."
            )
        none = np.empty((n_pixels, 0))
        self.directions = none if directions is None else as_numbers(directions, "directions")
        if not np.isfinite(self.directions).all():
            raise InvalidInputError("directions must be finite, but hold NaN or infinity.")
        if self.directions.ndim != 2 or len(self.directions) != n_pixels:
            raise InvalidInputError(
                f"directions must be of shape ({n_pixels}, n_directions), got "
                f"{self.directions.shape}."
            )
        self.n_images = 0
        self._total, self._of_targets = np.zeros(n_pixels), np.zeros(n_targets)
        self._with_targets = np.zeros((n_targets, n_pixels))
        self._products = np.zeros(self.directions.shape)

    def update(self, flat: NDArray[Any], targets: Array | None = None) -> Self:
        """Add a block of images (n, n_pixels), with targets (n, n_targets).

        Raises
        ------
        InvalidInputError
            If they are of other shapes, or not finite; nothing is added then.
        """
        images = self._normalised(np.asarray(flat))
        targets = np.empty((len(images), 0)) if targets is None else as_numbers(targets, "targets")
        if targets.shape != (len(images), len(self._of_targets)):
            raise InvalidInputError(
                f"targets must be of shape {(len(images), len(self._of_targets))}, one row an "
                f"image, got {targets.shape}."
            )
        if not np.isfinite(targets).all():
            raise InvalidInputError("targets must be finite, but hold NaN or infinity.")
        with one_blas_thread():
            self._total += images.sum(axis=0)
            self._of_targets += targets.sum(axis=0)
            self._with_targets += targets.T @ images
            self._products += images.T @ (images @ self.directions)
        self.n_images += len(images)
        return self

    def _normalised(self, flat: NDArray[Any]) -> Array:
        n_pixels = len(self._total)
        if flat.dtype.kind not in "biuf":
            raise InvalidInputError(f"Images must be arrays of numbers, got {flat.dtype}.")
        if flat.ndim != 2 or flat.shape[1] != n_pixels:
            raise InvalidInputError(
                f"Images must be of shape (n, {n_pixels}), one row an image, got {flat.shape}."
            )
        norms = brightness_norms(flat)
        if not np.isfinite(norms).all():
            raise InvalidInputError("Pixels must be finite, and their squares have a finite sum.")
        normalised: Array = flat / np.where(norms > 0, norms, 1.0)[:, None]
        return normalised

    def merge(self, other: ImageSums) -> Self:
        """Add the sums over other images, with as many targets and the same directions.

        Raises
        ------
        InvalidInputError
            If they are sums of others.
        """
        if self._with_targets.shape != other._with_targets.shape or not np.array_equal(
            self.directions, other.directions
        ):
            raise InvalidInputError(
                "Sums are merged if they are over as many pixels and targets, with the same "
                "directions; make both alike."
            )
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
    A randomised range finder [1]_ whose blocks are those of a Krylov space [2]_: each pass over the
    images adds the residuals ``X^T X v - lambda v`` of what was found. An eigenvalue is as near to
    the one that is found as its residual is long (Weyl), whatever the range finder missed within
    it; the iteration ends when that is under `PRECISION` of the largest, or rounding, for all that
    are wanted.

    References
    ----------
    .. [1] N. Halko, P. Martinsson and J. Tropp, "Finding structure with randomness", SIAM Review 53
       (2011), 217-288.
    .. [2] C. Musco and C. Musco, "Randomized block Krylov methods for stronger and faster
       approximate singular value decomposition", NeurIPS 28 (2015).
    """
    n_images, n_pixels = flat.shape
    n_directions = min(n_components + OVERSAMPLED, n_pixels, n_images)
    block = np.random.default_rng(0).normal(size=(n_pixels, n_directions))
    Q = products = np.empty((n_pixels, 0))
    with one_blas_thread():
        for _ in range(MOST_PASSES):
            block = _beyond(Q, block)
            found = sum_over(flat, directions=block)
            Q, products = np.hstack([Q, block]), np.hstack([products, found.products])
            values, vectors = eigh(Q.T @ products)
            values, vectors = values[: -n_directions - 1 : -1], vectors[:, : -n_directions - 1 : -1]
            leading, of_leading = Q @ vectors, products @ vectors
            block = of_leading - leading * values
            least = max(PRECISION * values[0], ROUNDING * n_images)
            if np.linalg.norm(block[:, :n_components], axis=0).max() <= least:
                break
            if Q.shape[1] >= MOST_BLOCKS * n_directions:
                Q, products = leading, of_leading
        else:
            raise InvalidInputError(
                f"{n_components} eigenvectors are not found in {MOST_PASSES} passes over the "
                "images, since their eigenvalues hardly differ, as those of noise; ask for fewer, "
                "or read the images into memory."
            )
    values, components = values[:n_components], leading[:, :n_components]
    n_found = int(np.count_nonzero(values > least))
    if n_found < n_components:
        raise InvalidInputError(
            f"{n_components} eigenvectors were wanted, but the {n_images} images, normalised and "
            f"centred, vary in {n_found} directions only; lower n_components."
        )
    return found.mean, values.copy(), components.T


def _beyond(Q: Array, block: Array) -> Array:
    """Orthonormal directions of a block that are not among those of Q, as many as there can be."""
    block = block[:, : len(Q) - Q.shape[1]]
    for _ in range(2):  # once more for what rounding left
        block = qr(block - Q @ (Q.T @ block), mode="economic", check_finite=False)[0]
    return block
