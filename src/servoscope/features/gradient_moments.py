"""Moments of gradient orientation: slope energy by direction, pooled in cells of the image."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import InvalidInputError
from servoscope.features.cells import check_n_cells
from servoscope.features.image_transformer import ImageTransformer
from servoscope.features.pixels import ImageShape
from servoscope.features.slopes import N_DIRECTIONS, orientation_cells


class GradientMoments(ImageTransformer):
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

    def fit(self, X: Any, y: Any = None) -> GradientMoments:
        """Take note of the size of the images; nothing else is learned.

        Parameters
        ----------
        X : array of shape (n_images, height, width) or (n_images, height * width)
        y : ignored

        Returns
        -------
        GradientMoments
            Itself.
        """
        check_n_cells(self.n_cells)
        if not isinstance(self.size, int | np.integer) or self.size < 1:
            raise InvalidInputError(f"size must be a whole number from 1, got {self.size!r}.")
        self._images_to_fit(X)
        blank = np.zeros(self.image_shape_, np.uint8)
        _, self.n_rows_, self.n_columns_ = orientation_cells(blank, self.size, self.n_cells).shape
        return self

    def transform(self, X: Any) -> NDArray[np.float64]:
        """Moments of gradient orientation of images.

        Parameters
        ----------
        X : array of shape (n_images, height, width) or (n_images, height * width)

        Returns
        -------
        ndarray of shape (n_images, 8 * n_rows_ * n_columns_)
            Of unit length for each image, or 0 for one without any slope.
        """
        images = self._images_to_transform(X).reshape(-1, *self.image_shape_)
        moments = np.empty((len(images), N_DIRECTIONS, self.n_rows_, self.n_columns_))
        for cells, image in zip(moments, images, strict=True):
            cells[:] = orientation_cells(image, self.size, self.n_cells)
        return moments.reshape(len(images), -1)

    def _feature_names(self) -> list[str]:
        return [
            f"o{360 * i // N_DIRECTIONS:03d}_{row}_{column}"
            for i in range(N_DIRECTIONS)
            for row in range(self.n_rows_)
            for column in range(self.n_columns_)
        ]
