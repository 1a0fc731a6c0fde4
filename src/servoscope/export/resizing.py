"""Images made small and blurred, as two products with matrices."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from servoscope.export.graph import Value

Array = NDArray[np.float64]


def reduction(size: int, to: int, sigma: float, border: int = cv2.BORDER_REPLICATE) -> Array:
    """The matrix (to, size) that makes a line of pixels `to` long, and blurs it, as OpenCV does.

    Resizing by areas and a Gaussian blur act on rows and columns one after the other, so that
    ``reduction(height, ...) @ image @ reduction(width, ...).T`` is what they make of an image.

    Examples
    --------
    >>> reduction(4, 2, 0.0)
    array([[0.5, 0.5, 0. , 0. ],
           [0. , 0. , 0.5, 0.5]])
    """
    matrix = np.eye(size)
    if to != size:
        matrix = np.asarray(cv2.resize(matrix, (size, to), interpolation=cv2.INTER_AREA))
    if sigma > 0:
        units = (unit.reshape(to, 1) for unit in np.eye(to))
        blurred = [cv2.GaussianBlur(unit, (0, 0), sigma, borderType=border) for unit in units]
        matrix = np.hstack(blurred) @ matrix
    return matrix


def reduced(
    image: Value,
    shape: tuple[int, int],
    to: tuple[int, int],
    sigma: float,
    border: int = cv2.BORDER_REPLICATE,
) -> Value:
    """An image of a shape (height, width) made small and blurred."""
    rows, columns = (
        reduction(size, end, sigma, border) for size, end in zip(shape, to, strict=True)
    )
    return rows @ image @ columns.T
