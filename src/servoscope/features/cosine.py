"""Cosine coefficients: the low end of the two-dimensional cosine transform."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from servoscope.features.fixed_projection import LowOrderProjection
from servoscope.features.pixels import ImageShape


class CosineCoefficients(LowOrderProjection):
    """Low coefficients of the cosine transform of brightness-normalised images.

    Parameters
    ----------
    order : int
        Highest number of half waves along x and y, both together; there are
        ``(order + 1) (order + 2) / 2`` coefficients. Images with a side of `order` pixels or
        less have fewer.
    image_shape : (height, width), optional
        What flat images are; 1 x n_pixels by default.

    Attributes
    ----------
    image_shape_ : (height, width)
    n_features_in_ : int
        Pixels of an image.

    Raises
    ------
    InvalidInputError
        If the order is not a whole number from 0, an image is not of the size seen in `fit`, or
        a pixel is not finite.

    Notes
    -----
    The orthonormal transform of type II [1]_, of grey levels divided by the Euclidean length of
    the image: ``c_ij`` has i half waves along x, the column, and j along y, the row.

    References
    ----------
    .. [1] N. Ahmed, T. Natarajan and K. R. Rao, "Discrete cosine transform", IEEE Transactions on
       Computers C-23 (1974), 90-93.

    Examples
    --------
    >>> images = np.full((1, 6, 8), 7, np.uint8)
    >>> cosines = CosineCoefficients(order=2).fit(images)
    >>> cosines.get_feature_names_out()
    array(['c_00', 'c_10', 'c_01', 'c_20', 'c_11', 'c_02'], dtype=object)
    >>> abs(cosines.transform(images).round(6))
    array([[1., 0., 0., 0., 0., 0.]])
    """

    _letter = "c"

    def __init__(self, order: int = 7, image_shape: ImageShape | None = None) -> None:
        self.order = order
        self.image_shape = image_shape

    def _basis(self, n_functions: int, n_pixels: int) -> NDArray[np.float64]:
        return cosine_waves(n_functions, n_pixels)


def cosine_waves(n_waves: int, n_points: int) -> NDArray[np.float64]:
    """Orthonormal cosines of 0, 1, ... half waves, of shape (n_waves, n_points).

    Examples
    --------
    >>> cosine_waves(2, 2).round(4)
    array([[ 0.7071,  0.7071],
           [ 0.7071, -0.7071]])
    """
    angles = np.pi * np.outer(np.arange(n_waves), np.arange(n_points) + 0.5) / n_points
    waves = np.sqrt(2 / n_points) * np.cos(angles)
    waves[0] = 1 / np.sqrt(n_points)
    return waves
