"""Moments of gradient orientation: slope energy by direction, pooled in cells of the image."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.features.cell_moments import CellMoments
from servoscope.features.pixels import ImageShape
from servoscope.features.slopes import N_DIRECTIONS, orientation_cells

Floats = NDArray[np.float32]


class GradientMoments(CellMoments):
    """How much slope there is in each of 8 directions about each cell of an image.

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
    Slopes are divided by their magnitude and twice its mean over the image, so that strong edges
    do not count much more than weak ones; each is shared among the directions within 90 degrees
    of its own by the squared cosine, as in the orientation histograms of [1]_. The moments of
    order 0 of the 8 maps are taken under Gaussian windows, a grid of them, in place of moments of
    higher order over the whole image; the square root of each share in the sum is the feature.

    Neither gain nor offset change the features as long as no pixel saturates. A light that falls
    off slowly changes them less than it does grey levels, though it adds a slope of its own to
    what is bright and without texture. What covers a part of the view changes the cells there
    and, by the mean and the sum, all the others slightly.

    References
    ----------
    .. [1] D. G. Lowe, "Distinctive image features from scale-invariant keypoints", International
       Journal of Computer Vision 60 (2004), 91-110.

    Examples
    --------
    >>> images = np.random.default_rng(0).integers(0, 100, (3, 64, 64), dtype=np.uint8)
    >>> moments = GradientMoments(n_cells=2).fit(images)
    >>> np.allclose(moments.transform(2 * images + 9), moments.transform(images), atol=1e-5)
    True
    >>> moments.get_feature_names_out()[[0, 1, 31]]
    array(['o000_0_0', 'o000_0_1', 'o315_1_1'], dtype=object)
    """

    def __init__(
        self, n_cells: int = 6, size: int = 128, image_shape: ImageShape | None = None
    ) -> None:
        self.n_cells = n_cells
        self.size = size
        self.image_shape = image_shape

    def _cells(self, image: NDArray[Any]) -> Floats:
        return orientation_cells(image, self.size, self.n_cells)

    def layer_names(self) -> list[str]:
        return [f"o{360 * i // N_DIRECTIONS:03d}" for i in range(N_DIRECTIONS)]
