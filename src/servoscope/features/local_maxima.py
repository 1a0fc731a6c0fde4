"""The brightest separate subwindows of an image."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from servoscope.errors import InvalidInputError


def centre_weighted_mask(window: int) -> NDArray[np.float64]:
    """Square mask of inverse distances to its centre, summing to 1.

    Parameters
    ----------
    window : int
        Side, [px]; even, so that the centre lies between pixels and no distance is 0.

    Raises
    ------
    InvalidInputError
        If the window is not an even number from 2.

    Examples
    --------
    >>> centre_weighted_mask(2)
    array([[0.25, 0.25],
           [0.25, 0.25]])
    """
    if not isinstance(window, int | np.integer) or window < 2 or window % 2:
        raise InvalidInputError(
            "window must be an even number of pixels from 2, so that its centre lies between "
            f"pixels, got {window!r}."
        )
    offsets = np.arange(window) - (window - 1) / 2
    mask = 1 / np.hypot(offsets[:, None], offsets)
    return mask / mask.sum()


def filter_centre_weighted(image: NDArray[Any], window: int) -> NDArray[np.float64]:
    """Mean of the subwindow around each pixel, weighted by `centre_weighted_mask`.

    The value at (row, column) is of the subwindow of rows ``row - window / 2`` to
    ``row + window / 2 - 1`` and columns likewise; what it covers beyond the border counts as 0.

    Examples
    --------
    >>> filter_centre_weighted(np.ones((2, 3)), window=2)
    array([[0.25, 0.5 , 0.5 ],
           [0.5 , 1.  , 1.  ]])
    """
    mask = centre_weighted_mask(window)
    image = np.asarray(image, dtype=np.float64)
    filtered = cv2.filter2D(image, cv2.CV_64F, mask, borderType=cv2.BORDER_CONSTANT)
    return filtered.astype(np.float64, copy=False)


def brightest_separate(image: NDArray[Any], n: int, window: int) -> NDArray[np.intp]:
    """The brightest pixels that are centres of subwindows which do not overlap.

    Parameters
    ----------
    image : ndarray of shape (height, width)
    n : int
        How many.
    window : int
        Side of a subwindow, [px]: any two pixels are that far apart in row or in column.

    Returns
    -------
    ndarray of shape (n, 2)
        Row and column of each, brightest first. Of equals, the first in reading order.

    Raises
    ------
    InvalidInputError
        If not so many are found.

    Examples
    --------
    >>> brightest_separate(np.array([[1, 9, 8, 0, 3]]), n=2, window=2).tolist()
    [[0, 1], [0, 4]]
    """
    left = np.array(image, dtype=np.float64)
    locations = np.empty((n, 2), dtype=np.intp)
    for i in range(n):
        row, column = np.unravel_index(left.argmax(), left.shape)
        if left[row, column] == -np.inf:
            raise InvalidInputError(
                f"{n} separate subwindows of {window} x {window} pixels were wanted, but only {i} "
                f"were found in an image of {left.shape[0]} x {left.shape[1]} (height x width); "
                "lower n_per_dof or window."
            )
        locations[i] = row, column
        rows = slice(max(row - window + 1, 0), row + window)
        left[rows, max(column - window + 1, 0) : column + window] = -np.inf
    return locations
