"""Moments of soft intensity slices, pooled in cells of the image."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from servoscope.features.cell_moments import CellMoments
from servoscope.features.cells import pool_in_cells
from servoscope.features.pixels import ImageShape
from servoscope.features.shrinking import shrink

Floats = NDArray[np.float32]

LEVELS = np.linspace(0.1, 1.1, 6, dtype=np.float32)
"""Grey levels that the slices lie about, in units of what is white in the image."""

_WHITE_QUANTILE = 0.8
_BLUR = 0.8


class IntensityMoments(CellMoments):
    """How much of each cell of an image lies in each of 6 soft slices of intensity.

    Parameters
    ----------
    n_cells : int
        Cells along either side of the image; no more than it has pixels.
    size : int
        Pixels along the longer side that larger images are shrunk to first.
    image_shape : (height, width), optional
        What flat images are; 1 x n_pixels by default.

    Attributes
    ----------
    n_rows_, n_columns_ : int
        Cells from top to bottom and from left to right.
    image_shape_ : (height, width)
    n_features_in_ : int
        Pixels of an image.

    Raises
    ------
    InvalidInputError
        If a parameter is no whole number from 1, an image is not of the size seen in `fit`, or a
        pixel is not finite.

    Notes
    -----
    `GeometricMoments` cuts an image into slices of intensity (section 3.1 of [1]_) and takes
    moments up to order 3 of each. Here the slices overlap, a grey level counting for the two
    nearest of 6 levels, more for the nearer, so that features change smoothly; their moments of
    order 0 are taken under Gaussian windows, a grid of them, and the square root of each cell's
    share is the feature. Grey levels are told in units of the 80 % quantile of the image, which
    something that covers a small part of the view hardly moves. Gain changes nothing as long as no
    pixel saturates; an offset and a light that falls off do.

    References
    ----------
    .. [1] G. Wells and C. Torras, "Assessing image features for vision-based robot positioning",
       Journal of Intelligent and Robotic Systems 30 (2001), 95-118.

    Examples
    --------
    >>> images = np.random.default_rng(0).integers(0, 100, (3, 64, 64), dtype=np.uint8)
    >>> moments = IntensityMoments(n_cells=2).fit(images)
    >>> np.allclose(moments.transform(2 * images), moments.transform(images), atol=1e-5)
    True
    >>> moments.get_feature_names_out()[[0, 1, 23]]
    array(['i010_0_0', 'i010_0_1', 'i110_1_1'], dtype=object)
    """

    def __init__(
        self, n_cells: int = 6, size: int = 128, image_shape: ImageShape | None = None
    ) -> None:
        self.n_cells = n_cells
        self.size = size
        self.image_shape = image_shape

    def _cells(self, image: NDArray[Any]) -> Floats:
        return intensity_cells(image, self.size, self.n_cells)

    def layer_names(self) -> list[str]:
        return intensity_names()


def intensity_cells(image: NDArray[Any], size: int, n_cells: int, gain: float = 1.0) -> Floats:
    """How much of each cell of an image lies in each of the soft slices about `LEVELS`.

    Parameters
    ----------
    image : ndarray of shape (height, width)
    size : int
        Pixels along the longer side that a larger image is shrunk to first.
    n_cells : int
        Cells along either side.
    gain : float
        What the image is multiplied with after its white was determined.

    Returns
    -------
    ndarray of shape (6, n_rows, n_columns), float32
        Square roots of shares that sum to 1 in each cell; the outer slices take what is beyond.

    Examples
    --------
    >>> intensity_cells(np.full((8, 8), 70, np.uint8), size=8, n_cells=1)[:, 0, 0].round(2)
    array([0.  , 0.  , 0.  , 0.  , 0.71, 0.71], dtype=float32)
    """
    small = cv2.GaussianBlur(shrink(image, size), (0, 0), _BLUR)
    white = float(np.quantile(small, _WHITE_QUANTILE))
    scaled = small * (gain / white) if white > 0 else np.zeros_like(small)
    step = LEVELS[1] - LEVELS[0]
    away = np.abs(np.clip(scaled, LEVELS[0], LEVELS[-1]) - LEVELS[:, None, None])
    return np.sqrt(pool_in_cells(np.maximum(1 - away / step, 0).astype(np.float32), n_cells))


def intensity_names() -> list[str]:
    """Names of the slices, by their level in hundredths of white."""
    return [f"i{round(100 * level):03d}" for level in LEVELS.tolist()]
