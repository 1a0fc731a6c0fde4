"""Sums over brightness-normalised images: projections, inner products, weighted sums."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from servoscope.errors import InvalidInputError
from servoscope.processes import one_blas_thread
from servoscope.storage.stacks import Stack, blocks_of

BLOCK_ELEMENTS = 2**21
"""Pixels of all images together that are worked on at a time."""

BlockResult = tuple[slice, NDArray[np.float64], Any]


def brightness_norms(flat: NDArray[Any]) -> NDArray[np.float64]:
    """Euclidean length of each image, exact up to its rounding for uint8 images.

    Examples
    --------
    >>> brightness_norms(np.array([[3, 4], [0, 0]], np.uint8))
    array([5., 0.])
    """
    rows = (row.astype(np.float64, copy=False) for row in flat)
    return np.sqrt([np.einsum("i,i", row, row) for row in rows])


def working_dtype(flat: NDArray[Any]) -> type[np.floating[Any]]:
    """float32 for uint8 and float32 images, float64 for others."""
    return np.float32 if flat.dtype in (np.uint8, np.float32) else np.float64


def brightness_gains(flat: NDArray[Any]) -> NDArray[Any]:
    """What each image is multiplied with to have unit length; 0 for a black one.

    Pixels so large that their squares have no finite sum are refused.

    Examples
    --------
    >>> brightness_gains(np.array([[3.0, 4.0], [0.0, 0.0]]))
    array([0.2, 0. ])
    """
    norms = brightness_norms(flat)
    unbounded = np.flatnonzero(~np.isfinite(norms))
    if unbounded.size:
        raise InvalidInputError(
            "Pixels must be small enough for their squares to be summed, but those of image "
            f"{unbounded[0]} are not; scale the images down."
        )
    gains = np.divide(1.0, norms, out=np.zeros_like(norms), where=norms > 0)
    return gains.astype(working_dtype(flat))


def map_blocks(
    compute: Callable[[NDArray[Any], slice], Any],
    flat: NDArray[Any],
    mean: NDArray[np.float64] | None = None,
) -> Iterator[BlockResult]:
    """What a function gives for each block of brightness-normalised, centred images.

    Yielded are the slice of pixels of the block, what was taken from each of them (their own mean
    by default), and what `compute` gave for (n_images, n_block) values of `working_dtype` and the
    slice.

    Blocks are shared among as many threads as BLAS is allowed, with BLAS itself on one, and their
    results come in the order of the pixels. Sums of them are therefore the same, bit for bit, for
    any number of threads. No copy of all the images is ever made.

    Notes
    -----
    Each image is divided by its Euclidean length (after eq. 8). An all-black image, which has
    none, stays black.
    """
    gain = brightness_gains(flat)

    def work(pixels: slice) -> BlockResult:
        block = flat[:, pixels].astype(gain.dtype)
        block *= gain[:, None]
        block_mean = block.mean(axis=0, dtype=np.float64) if mean is None else mean[pixels]
        block -= block_mean.astype(gain.dtype)
        return pixels, block_mean, compute(block, pixels)

    n_images, n_pixels = flat.shape
    width = max(BLOCK_ELEMENTS // max(n_images, 1), 64)
    blocks = [slice(start, start + width) for start in range(0, n_pixels, width)]
    with one_blas_thread() as n_threads:
        if min(n_threads, len(blocks)) == 1:
            yield from map(work, blocks)
        else:
            yield from _map_in_threads(work, blocks, n_threads)


def project_images(
    flat: NDArray[Any], mean: NDArray[np.float64], components: NDArray[Any]
) -> NDArray[np.float64]:
    """Projections (n_images, n_components) of brightness-normalised images about a mean.

    Examples
    --------
    >>> project_images(np.array([[3.0, 4.0]]), np.array([0.5, 0.5]), np.eye(2))
    array([[0.1, 0.3]])
    """
    if isinstance(flat, Stack):
        return np.concatenate([project_images(b, mean, components) for b in blocks_of(flat)])

    def project(block: NDArray[Any], pixels: slice) -> NDArray[Any]:
        return block @ components[:, pixels].T.astype(block.dtype, copy=False)

    projections = np.zeros((len(flat), len(components)))
    for _, _, part in map_blocks(project, flat, mean):
        projections += part
    return projections


def _map_in_threads(
    work: Callable[[slice], BlockResult], blocks: list[slice], n_threads: int
) -> Iterator[BlockResult]:
    pending: deque[Future[BlockResult]] = deque()
    with ThreadPoolExecutor(n_threads) as pool:
        for pixels in blocks:
            pending.append(pool.submit(work, pixels))
            if len(pending) > n_threads:
                yield pending.popleft().result()
        while pending:
            yield pending.popleft().result()


def mean_and_gram(flat: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean (n_pixels,) of brightness-normalised images, and their inner products about it, ``X
    X^T``. Products of uint8 images are float32, summed in float64 over blocks of pixels.

    Examples
    --------
    >>> mean, gram = mean_and_gram(np.array([[3.0, 4.0], [4.0, 3.0]]))
    >>> mean, gram.round(3)
    (array([0.7, 0.7]), array([[ 0.02, -0.02],
           [-0.02,  0.02]]))
    """
    mean, gram = np.empty(flat.shape[1]), np.zeros((len(flat), len(flat)))
    for pixels, block_mean, part in map_blocks(lambda block, _: block @ block.T, flat):
        mean[pixels] = block_mean
        gram += part
    return mean, gram


def span_coordinates(flat: NDArray[Any]) -> NDArray[np.float64]:
    """Coordinates of brightness-normalised images along orthonormal directions that span them.

    Features that depend on images through their inner products alone, such as eigenfeatures, are
    the same of these as of the images, but for rounding and signs. Directions that rounding may
    have made are left out.

    Examples
    --------
    >>> images = np.random.default_rng(0).uniform(1, 9, (5, 100))
    >>> coordinates = span_coordinates(images)
    >>> np.allclose(coordinates @ coordinates.T, [
    ...     [a @ b / np.sqrt(a @ a * (b @ b)) for a in images] for b in images])
    True
    """
    products = np.zeros((len(flat), len(flat)))
    for _, _, part in map_blocks(lambda block, _: block @ block.T, flat, np.zeros(flat.shape[1])):
        products += part
    with one_blas_thread():
        eigenvalues, vectors = eigh(products)
    kept = eigenvalues > rounding_variance(flat, eigenvalues[-1])
    return np.asarray(vectors[:, kept] * np.sqrt(eigenvalues[kept]))


def rounding_variance(flat: NDArray[Any], largest: float) -> float:
    """Up to what size an eigenvalue of the inner products of images may be due to rounding."""
    precision = float(np.finfo(working_dtype(flat)).eps)
    share = max(precision, len(flat) * float(np.finfo(np.float64).eps))
    return max(share * largest, len(flat) * precision**2)


def sum_images(
    flat: NDArray[Any], mean: NDArray[np.float64], weights: NDArray[np.float64]
) -> NDArray[Any]:
    """Weighted sums (n_sums, n_pixels) of brightness-normalised images about their mean."""
    weights = weights.astype(working_dtype(flat))
    sums = np.empty((weights.shape[1], flat.shape[1]), weights.dtype)
    for pixels, _, part in map_blocks(lambda block, _: weights.T @ block, flat, mean):
        sums[:, pixels] = part
    return sums


def extremes_made_positive(components: NDArray[Any]) -> NDArray[Any]:
    """Rows, some of them turned around, whose entry of largest magnitude is positive.

    Examples
    --------
    >>> extremes_made_positive(np.array([[1.0, -2.0], [0.0, 3.0]]))
    array([[-1.,  2.],
           [ 0.,  3.]])
    """
    extremes = components[np.arange(len(components)), np.abs(components).argmax(axis=1)]
    return components * np.sign(extremes)[:, None]
