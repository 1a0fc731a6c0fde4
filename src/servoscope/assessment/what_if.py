"""What would change if the camera saw less, or the part were put down more precisely."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from servoscope.assessment.candidates import forecast_family
from servoscope.processes import in_processes

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

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


def forecast_without_border(
    images: NDArray[np.uint8],
    targets: Array,
    groups: Indices | None,
    families: Iterable[str],
    *,
    n_jobs: int | None = -1,
) -> dict[str, Array | None]:
    """RMS errors that families are forecast to reach on the middle of the view alone.

    Parameters
    ----------
    images : ndarray of shape (n, height, width), uint8
        To learn from.
    targets : ndarray of shape (n, 6)
    groups : ndarray of shape (n,), optional
    families : iterable of str

    Returns
    -------
    dict of ndarray of shape (6,)
        In units of the targets; None for a family that cannot be had of so small a view.
    """
    names = sorted(set(families))
    middle = np.ascontiguousarray(crop_centre(images))
    calls = ((middle, targets, groups, name) for name in names)
    forecasts = list(in_processes(forecast_family, calls, n_jobs))
    return {
        name: None if forecast is None else forecast.rms
        for name, forecast in zip(names, forecasts, strict=True)
    }


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
