"""Products of all brightness-normalised images with each other, and sums of them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from servoscope.features.pixel_blocks import map_blocks, working_dtype
from servoscope.processes import one_blas_thread


def mean_and_gram(flat: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean of brightness-normalised images, and their inner products about it.

    Parameters
    ----------
    flat : ndarray of shape (n_images, n_pixels)

    Returns
    -------
    mean : ndarray of shape (n_pixels,)
    gram : ndarray of shape (n_images, n_images)
        ``X X^T`` of the images as rows, normalised and centred. Products of uint8 images are
        float32, summed in float64 over blocks of pixels.

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
    the same of these as of the images, but for rounding and signs.

    Parameters
    ----------
    flat : ndarray of shape (n_images, n_pixels)

    Returns
    -------
    ndarray of shape (n_images, n_directions)
        No more directions than images; those that rounding may have made are left out.

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
    """Up to what size an eigenvalue of the inner products may be due to rounding.

    Parameters
    ----------
    flat : ndarray of shape (n_images, n_pixels)
        The images, whose number and `working_dtype` matter.
    largest : float
        The largest eigenvalue.
    """
    precision = float(np.finfo(working_dtype(flat)).eps)
    share = max(precision, len(flat) * float(np.finfo(np.float64).eps))
    return max(share * largest, len(flat) * precision**2)


def sum_images(
    flat: NDArray[Any], mean: NDArray[np.float64], weights: NDArray[np.float64]
) -> NDArray[Any]:
    """Weighted sums of brightness-normalised images about their mean.

    Parameters
    ----------
    flat : ndarray of shape (n_images, n_pixels)
    mean : ndarray of shape (n_pixels,)
    weights : ndarray of shape (n_images, n_sums)

    Returns
    -------
    ndarray of shape (n_sums, n_pixels)
        Of `working_dtype`.
    """
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
