"""What would change if the camera saw less, or the part were put down more precisely."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

KEPT = 0.8
"""Share of each side of the view that is kept when its border is cut away."""

INNER = 0.5
"""Share of the range within which the inner error is taken."""


def crop_centre(images: NDArray[np.uint8], share: float = KEPT) -> NDArray[np.uint8]:
    """The middle of images, `share` of each side.

    Examples
    --------
    >>> crop_centre(np.zeros((2, 100, 50), np.uint8)).shape
    (2, 80, 40)
    """
    rows, columns = images.shape[1:]
    top, left = round((1 - share) / 2 * rows), round((1 - share) / 2 * columns)
    return images[:, top : rows - top, left : columns - left]


def inner_rms(residuals: Array, targets: Array) -> float | None:
    """RMS of the residuals where a target is within half its range; None where hardly any is.

    Parameters
    ----------
    residuals, targets : ndarrays of shape (n,)
        In units of the range.
    """
    inner = np.abs(targets) <= INNER
    if np.count_nonzero(inner) < 20:
        return None
    return float(np.sqrt(np.mean(residuals[inner] ** 2)))
