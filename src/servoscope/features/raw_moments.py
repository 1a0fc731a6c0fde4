"""Raw moments of intensity slices: exact integers, in one pass over each image."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.compiled import compiled
from servoscope.errors import InvalidInputError

ORDERS = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3))
"""The orders (i, j) of x and y, of every moment to order 3."""

_CHUNK = 128
_U = np.arange(_CHUNK, dtype=np.int16) - np.int16(_CHUNK // 2)
_U_SQUARED = _U**2


def compute_raw_moments(
    images: NDArray[np.uint8], slices: Sequence[tuple[int, int]]
) -> NDArray[np.int64]:
    """Raw moments to order 3 of every intensity slice of every image, exactly.

    Parameters
    ----------
    images : ndarray of shape (n_images, height, width), uint8
    slices : sequence of (lower, upper)
        A pixel is in the slice if ``lower <= grey < upper``.

    Returns
    -------
    ndarray of shape (n_images, n_slices, 10), int64
        ``m_ij`` in `ORDERS`, [grey px^(i + j)].

    Raises
    ------
    InvalidInputError
        If the images are so large that a moment might not fit in 64 bits.

    Notes
    -----
    Eq. 1 of the paper, ``m_ij = sum x^i y^j f(x, y)`` with x the column, y the row and f the grey
    level inside the slice, 0 outside.

    Examples
    --------
    >>> images = np.zeros((1, 4, 6), np.uint8)
    >>> images[0, 2, 5] = 10
    >>> compute_raw_moments(images, [(0, 50)])[0, 0]
    array([  10,   50,   20,  250,  100,   40, 1250,  500,  200,   80])
    """
    _check_size(*images.shape[1:])
    bounds = np.array(slices, dtype=np.int16).reshape(-1, 2)
    moments = np.empty((len(images), len(bounds), len(ORDERS)), dtype=np.int64)
    _sum_moments(np.ascontiguousarray(images), bounds, moments)
    return moments


def largest_raw_moment(height: int, width: int) -> int:
    """The largest raw moment to order 3 that an 8-bit image of this size can have.

    Examples
    --------
    >>> largest_raw_moment(2048, 2048) < 2**63
    True
    """
    sums = [[sum(k**order for k in range(side)) for order in range(4)] for side in (width, height)]
    return max(255 * sums[0][i] * sums[1][j] for i, j in ORDERS)


def _check_size(height: int, width: int) -> None:
    if max(height, width) > 2048 and largest_raw_moment(height, width) >= 2**63:
        raise InvalidInputError(
            f"Moments of images of {height} x {width} (height x width) might not fit in 64 bits; "
            "resize them to at most 2048 pixels a side, or say the image_shape of flat ones."
        )


@compiled()
def _sum_moments(
    images: NDArray[Any], bounds: NDArray[Any], moments: NDArray[Any]
) -> None:  # pragma: no cover
    n_images, height, _ = images.shape
    for n in range(n_images):
        moments[n] = 0
        for y in range(height):
            for s in range(bounds.shape[0]):
                m0, m1, m2, m3 = _row_moments(images[n, y], bounds[s, 0], bounds[s, 1])
                m = moments[n, s]
                m[0] += m0
                m[1] += m1
                m[2] += y * m0
                m[3] += m2
                m[4] += y * m1
                m[5] += y * y * m0
                m[6] += m3
                m[7] += y * m2
                m[8] += y * y * m1
                m[9] += y * y * y * m0


@compiled()
def _row_moments(row: NDArray[Any], lower: Any, upper: Any) -> Any:  # pragma: no cover
    m0 = m1 = m2 = m3 = np.int64(0)
    for start in range(0, len(row), _CHUNK):
        # A whole chunk has a length that the compiler knows, and unrolls.
        if start + _CHUNK <= len(row):
            c0, c1, c2, c3 = _chunk_moments(row, start, _CHUNK, lower, upper)
        else:
            c0, c1, c2, c3 = _chunk_moments(row, start, len(row) - start, lower, upper)
        x = np.int64(start + _CHUNK // 2)
        m0 += c0
        m1 += c1 + x * c0
        m2 += c2 + x * (2 * c1 + x * c0)
        m3 += c3 + x * (3 * c2 + x * (3 * c1 + x * c0))
    return m0, m1, m2, m3


@compiled()
def _chunk_moments(
    row: NDArray[Any], start: int, length: int, lower: Any, upper: Any
) -> Any:  # pragma: no cover
    # About the middle of 128 pixels, u f and u^2 fit in 16 bits, and the sum of u^3 f, at most
    # 255 (64 * 65 / 2)^2, in 32: the processor multiplies and adds 32 pixels at a time.
    c0 = c1 = c2 = c3 = np.int32(0)
    for k in range(length):
        grey = np.int16(row[np.uint64(start) + np.uint64(k)])
        f = grey if lower <= grey < upper else np.int16(0)
        uf = np.int16(_U[k] * f)
        c0 = np.int32(c0 + f)
        c1 = np.int32(c1 + uf)
        c2 = np.int32(c2 + np.int32(np.int32(_U_SQUARED[k]) * np.int32(f)))
        c3 = np.int32(c3 + np.int32(np.int32(_U_SQUARED[k]) * np.int32(uf)))
    return np.int64(c0), np.int64(c1), np.int64(c2), np.int64(c3)
