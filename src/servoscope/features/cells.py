"""Images made small, their slopes, and what lies in each cell of a grid."""

from __future__ import annotations

from functools import cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]


def shrink(image: NDArray[Any], size: int) -> Floats:
    """An image whose longer side is `size` pixels, or as it is if that is less, float32.

    Examples
    --------
    >>> shrink(np.full((20, 40), 7, np.uint8), 10).shape
    (5, 10)
    """
    scale = min(1.0, size / max(image.shape))
    height, width = (max(1, round(scale * side)) for side in image.shape)
    whole = image.astype(np.float32)
    return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA))


_WIDTH = 0.6
"""Standard deviation of a cell's weights, in cells."""


def pool_in_cells(layers: Floats, n_cells: int) -> Floats:
    """Mean of each layer about each cell, by Gaussian weights.

    Parameters
    ----------
    layers : ndarray of shape (..., height, width), float32
    n_cells : int
        Cells along either side; no more than there are pixels.

    Returns
    -------
    ndarray of shape (..., n_rows, n_columns), float32

    Examples
    --------
    >>> pool_in_cells(np.ones((5, 12, 2), np.float32), n_cells=4).shape
    (5, 4, 2)
    """
    rows, columns = _weights(layers.shape[-2], n_cells), _weights(layers.shape[-1], n_cells)
    return np.asarray(rows @ layers @ columns.T, dtype=np.float32)


def cell_names(layers: list[str], n_rows: int, n_columns: int) -> list[str]:
    """Names of the cells of layers, in the order of their values flattened.

    Examples
    --------
    >>> cell_names(["a", "b"], n_rows=1, n_columns=2)
    ['a_0_0', 'a_0_1', 'b_0_0', 'b_0_1']
    """
    cells = [f"{row}_{column}" for row in range(n_rows) for column in range(n_columns)]
    return [f"{layer}_{cell}" for layer in layers for cell in cells]


@cache
def _weights(size: int, n_cells: int) -> Floats:
    """Weights of the pixels along a side for each of the cells along it."""
    n_cells = min(n_cells, size)
    centres = (np.arange(n_cells) + 0.5) * size / n_cells
    away = (np.arange(size) + 0.5 - centres[:, None]) / (_WIDTH * size / n_cells)
    weights = np.exp(-0.5 * away**2)
    return (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32)


N_DIRECTIONS = 8

_BLUR = 0.8


def orientation_cells(image: NDArray[Any], size: int, n_cells: int) -> Floats:
    """How much slope there is in each of 8 directions about each cell of an image.

    Each slope, over its magnitude and twice the mean one, counts for the directions within 90
    degrees of its own by the squared cosine, and for cells by a Gaussian. What comes back is the
    square root of each share in the whole, so that all of them together have unit length.

    Parameters
    ----------
    image : ndarray of shape (height, width)
    size : int
        Pixels along the longer side of what the slopes are taken of.
    n_cells : int
        Cells along either side.

    Returns
    -------
    ndarray of shape (8, n_rows, n_columns), float32
        Direction i is i times 45 degrees, from x, along the columns, towards y, down the rows.

    Examples
    --------
    >>> ramp = np.arange(64, dtype=np.uint8) * np.ones((64, 1), np.uint8)
    >>> orientation_cells(ramp, size=64, n_cells=3).sum(axis=(1, 2)).argmax()
    np.int64(0)
    """
    slopes = _normalised_slopes(image, size)
    magnitude = np.maximum(np.hypot(slopes[0], slopes[1]), np.float32(1e-6))
    angles = 2 * np.pi * np.arange(N_DIRECTIONS, dtype=np.float32) / N_DIRECTIONS
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    along = np.maximum(np.tensordot(directions, slopes, axes=1), 0)
    pooled = np.maximum(pool_in_cells(along * along / magnitude, n_cells), 0)
    total = pooled.sum()
    return np.sqrt(pooled / total) if total > 0 else pooled


def _normalised_slopes(image: NDArray[Any], size: int) -> Floats:
    """Slopes of an image made small, over their magnitude and twice its mean, (2, rows, columns).

    Neither gain nor offset change them, and something that covers the view or shines changes only
    those beside it, but for the mean. They are 0 throughout an image without anything in it.
    """
    small = cv2.GaussianBlur(shrink(image, size), (0, 0), _BLUR)
    slopes = np.empty((2, *small.shape), np.float32)
    slopes[0], slopes[1] = cv2.Sobel(small, -1, 1, 0), cv2.Sobel(small, -1, 0, 1)
    magnitude = np.hypot(slopes[0], slopes[1])
    scale = np.broadcast_to(magnitude + np.float32(2 * magnitude.mean()), slopes.shape)
    return np.divide(slopes, scale, out=np.zeros_like(slopes), where=scale > 0)
