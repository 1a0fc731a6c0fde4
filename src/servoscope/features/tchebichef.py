"""Tchebichef moments: projections of images onto discrete orthogonal polynomials."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from servoscope.features.fixed_projection import LowOrderProjection
from servoscope.features.pixels import ImageShape


class TchebichefMoments(LowOrderProjection):
    """Tchebichef moments of brightness-normalised images.

    Parameters
    ----------
    order : int
        Highest degree of the polynomials in x and y, both degrees together; there are
        ``(order + 1) (order + 2) / 2`` moments. Images with a side of `order` pixels or less
        have fewer.
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
    ``t_ij = sum t_i(x) t_j(y) f(x, y)`` [1]_, with x the column, y the row and f the grey level
    divided by the Euclidean length of the image. The polynomials are orthonormal on the pixels
    themselves, so, other than geometric moments, these are computed without quadrature, do not
    repeat one another, and have sizes alike whatever the order.

    References
    ----------
    .. [1] R. Mukundan, S. H. Ong and P. A. Lee, "Image analysis by Tchebichef moments", IEEE
       Transactions on Image Processing 10 (2001), 1357-1364.

    Examples
    --------
    >>> images = np.full((1, 6, 8), 7, np.uint8)
    >>> moments = TchebichefMoments(order=2).fit(images)
    >>> moments.get_feature_names_out()
    array(['t_00', 't_10', 't_01', 't_20', 't_11', 't_02'], dtype=object)
    >>> abs(moments.transform(images).round(6))
    array([[1., 0., 0., 0., 0., 0.]])
    """

    _letter = "t"

    def __init__(self, order: int = 7, image_shape: ImageShape | None = None) -> None:
        self.order = order
        self.image_shape = image_shape

    def _basis(self, n_functions: int, n_pixels: int) -> NDArray[np.float64]:
        return tchebichef_polynomials(n_functions, n_pixels)


def tchebichef_polynomials(n_polynomials: int, n_points: int) -> NDArray[np.float64]:
    """Orthonormal discrete Tchebichef polynomials of degree 0, 1, ... on 0..n_points - 1.

    Parameters
    ----------
    n_polynomials : int
        At most `n_points`.
    n_points : int

    Returns
    -------
    ndarray of shape (n_polynomials, n_points)

    Notes
    -----
    The three-term recurrence of orthonormal polynomials, on points centred on 0:
    ``b_n t_n = x t_{n-1} - b_{n-1} t_{n-2}`` with ``b_n^2 = n^2 (N^2 - n^2) / (4 (4 n^2 - 1))``.
    What rounding leaves of the earlier polynomials, which the recurrence would magnify where the
    degree comes near to the number of points, is taken from each.

    Examples
    --------
    >>> tchebichef_polynomials(2, 3).round(4)
    array([[ 0.5774,  0.5774,  0.5774],
           [-0.7071,  0.    ,  0.7071]])
    """
    x = np.arange(n_points) - (n_points - 1) / 2
    t = np.zeros((n_polynomials, n_points))
    t[0] = 1 / np.sqrt(n_points)
    previous, b = np.zeros(n_points), 0.0
    for n in range(1, n_polynomials):
        t[n] = x * t[n - 1] - b * previous
        t[n] -= t[:n].T @ (t[:n] @ t[n])
        b = n * np.sqrt((n_points**2 - n**2) / (4 * n**2 - 1)) / 2
        t[n] /= b
        previous = t[n - 1]
    return t
