"""What features are taken of: images made small, locally normalised, or told by their slopes."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from servoscope.features.moments import PAPER_SLICES, compute_descriptors
from servoscope.features.raw_moments import compute_raw_moments
from servoscope.positioning.appearance import shrink

Image = NDArray[np.uint8]
Vector = NDArray[np.float32]

GREY_SIZE, LOCAL_SIZE, GRADIENT_SIZE, ORIENTATION_SIZE = 64, 32, 24, 64
"""Pixels along the longer side of what each preparation looks at."""

ORIENTATIONS, CELLS = 8, 8
_BLUR, _NEIGHBOURHOOD = 0.8, 4.0


def moments(image: Image) -> Vector:
    """The paper's 24 geometric moments of the image at full size."""
    raw = compute_raw_moments(image[None], PAPER_SLICES)
    return compute_descriptors(raw, (image.shape[0], image.shape[1])).ravel().astype(np.float32)


def grey(image: Image) -> Vector:
    """The image itself made small, of unit length (after eq. 8 of the paper)."""
    return _unit(shrink(image, GREY_SIZE))


def local(image: Image) -> Vector:
    """Contrast with the surroundings in units of the surroundings' own, of unit length.

    Where they have much less contrast than the image has elsewhere, it fades to 0. Neither gain
    nor offset change it, and a light that falls off slowly hardly does.

    Examples
    --------
    >>> image = np.random.default_rng(0).integers(0, 100, (64, 64), dtype=np.uint8)
    >>> np.allclose(local(2 * image + 9), local(image), atol=1e-5)
    True
    """
    small = _blurred(shrink(image, LOCAL_SIZE), _BLUR)
    contrast = small - _blurred(small, _NEIGHBOURHOOD)
    scale = np.sqrt(_blurred(contrast * contrast, _NEIGHBOURHOOD))
    return _unit(_divided(contrast, scale, 0.5 * np.median(scale)))


def gradient(image: Image) -> Vector:
    """Slopes along x and y divided by their magnitude and twice its mean, of unit length.

    Neither gain nor offset change them, and something that covers the view or shines changes
    only those beside it.

    Examples
    --------
    >>> image = np.random.default_rng(0).integers(0, 100, (64, 64), dtype=np.uint8)
    >>> np.allclose(gradient(2 * image + 9), gradient(image), atol=1e-5)
    True
    """
    return _unit(_normalised_slopes(image, GRADIENT_SIZE))


def orientation(image: Image) -> Vector:
    """How much slope there is in each of 8 directions about each of 8 x 8 places.

    The slopes are those of `gradient`, at twice the size or more; each counts for the directions
    within 90 degrees of its own by the squared cosine, and for places by a Gaussian. What counts
    is the square root of each share in the whole, so that the vector has unit length. It changes
    more smoothly with the pose than slopes at one place do.

    Examples
    --------
    >>> image = np.random.default_rng(0).integers(0, 100, (64, 64), dtype=np.uint8)
    >>> orientation(image).shape
    (512,)
    """
    slopes = _normalised_slopes(image, ORIENTATION_SIZE)
    magnitude = np.maximum(np.hypot(slopes[0], slopes[1]), np.float32(1e-6))
    angles = 2 * np.pi * np.arange(ORIENTATIONS, dtype=np.float32) / ORIENTATIONS
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    along = np.maximum(np.tensordot(directions, slopes, axes=1), 0)
    votes = along * along / magnitude
    rows, columns = _pooling(votes.shape[1]), _pooling(votes.shape[2])
    pooled = np.maximum((rows @ votes @ columns.T).ravel(), 0)
    total = pooled.sum()
    return np.sqrt(pooled / total) if total > 0 else pooled


PREPARATIONS: dict[str, Callable[[Image], Vector]] = {
    "moments": moments,
    "grey": grey,
    "local": local,
    "gradient": gradient,
    "orientation": orientation,
}
"""What can be made of an image, by name."""


def _blurred(values: NDArray[np.float32], sigma: float) -> NDArray[np.float32]:
    return np.asarray(cv2.GaussianBlur(values, (0, 0), sigma))


def _normalised_slopes(image: Image, size: int) -> NDArray[np.float32]:
    small = _blurred(shrink(image, size), _BLUR)
    slopes = np.empty((2, *small.shape), np.float32)
    slopes[0], slopes[1] = cv2.Sobel(small, -1, 1, 0), cv2.Sobel(small, -1, 0, 1)
    magnitude = np.hypot(slopes[0], slopes[1])
    return _divided(slopes, magnitude, 2 * magnitude.mean())


def _divided(
    values: NDArray[np.float32], scale: NDArray[np.float32], floor: np.floating
) -> NDArray[np.float32]:
    """Values over their scale and a floor; 0 where both are."""
    whole = np.broadcast_to(scale + np.float32(floor), values.shape)
    return np.divide(values, whole, out=np.zeros_like(values), where=whole > 0)


def _unit(values: NDArray[np.float32]) -> Vector:
    flat = values.ravel()
    length = np.sqrt(flat @ flat)
    return flat / length if length > 0 else flat


@cache
def _pooling(size: int) -> NDArray[np.float32]:
    """Gaussian weights of the pixels along a side for each of the places along it."""
    n_cells = min(CELLS, size)
    centres = (np.arange(n_cells) + 0.5) * size / n_cells
    away = (np.arange(size) + 0.5 - centres[:, None]) / (0.6 * size / n_cells)
    weights = np.exp(-0.5 * away**2)
    return (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32)
