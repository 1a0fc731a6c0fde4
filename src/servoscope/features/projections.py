"""Projections of images onto lines: profiles along a few directions, coarsely described."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.features.fixed_projection import FixedProjection, check_whole_number
from servoscope.features.pixel_blocks import project_images
from servoscope.features.pixels import ImageShape


class ImageProjections(FixedProjection):
    """Low cosine coefficients of the profiles of brightness-normalised images.

    Parameters
    ----------
    n_angles : int
        Number of directions; the first is along x, and they divide half a turn evenly. Two are
        the sums over columns and over rows.
    n_coefficients : int
        Number of coefficients of each profile.
    image_shape : (height, width), optional
        What flat images are; 1 x n_pixels by default.

    Attributes
    ----------
    components_ : ndarray of shape (1 + n_angles * n_coefficients, n_pixels)
        What images are projected onto.
    image_shape_ : (height, width)
    n_features_in_ : int
        Pixels of an image.

    Raises
    ------
    InvalidInputError
        If a number is not a whole one from 1, an image is not of the size seen in `fit`, or a
        pixel is not finite.

    Notes
    -----
    The profile in a direction, ``g(s)``, is the sum of the image over the lines across it, its
    Radon transform [1]_. With s from 0 to 1 where these lines cross the image at all, coefficient
    k is ``sum g(s) cos(k pi s)``, over the root of the number of pixels. The sum of all grey
    levels, ``k = 0``, is the same in all directions and stands once. As cosines of lines are
    functions of the pixels, each coefficient is one product with the image: no profile is ever
    binned, and nothing is interpolated.

    References
    ----------
    .. [1] S. R. Deans, "The Radon Transform and Some of Its Applications", Wiley, 1983.

    Examples
    --------
    >>> images = np.random.default_rng(0).integers(0, 256, (20, 8, 8), dtype=np.uint8)
    >>> projections = ImageProjections(n_angles=2, n_coefficients=2).fit(images)
    >>> projections.get_feature_names_out()
    array(['p_sum', 'p_0_1', 'p_0_2', 'p_90_1', 'p_90_2'], dtype=object)
    """

    components_: NDArray[np.float64]

    def __init__(
        self,
        n_angles: int = 8,
        n_coefficients: int = 7,
        image_shape: ImageShape | None = None,
    ) -> None:
        self.n_angles = n_angles
        self.n_coefficients = n_coefficients
        self.image_shape = image_shape

    def _prepare(self) -> None:
        check_whole_number("n_angles", self.n_angles, 1)
        check_whole_number("n_coefficients", self.n_coefficients, 1)
        height, width = self.image_shape_
        y, x = np.indices((height, width)).reshape(2, -1) + 0.5
        scale = 1 / np.sqrt(height * width)
        orders = range(1, self.n_coefficients + 1)
        self.components_ = np.empty((1 + self.n_angles * self.n_coefficients, height * width))
        self.components_[0] = scale
        for i, angle in enumerate(np.pi * np.arange(self.n_angles) / self.n_angles):
            c, s = np.cos(angle), np.sin(angle)
            extent = abs(c) * width + abs(s) * height
            along = 0.5 + (c * (x - width / 2) + s * (y - height / 2)) / extent
            for k in orders:
                self.components_[i * len(orders) + k] = scale * np.cos(np.pi * k * along)

    def _features(self, flat: NDArray[Any]) -> NDArray[np.float64]:
        return project_images(flat, np.zeros(flat.shape[1]), self.components_)

    def _feature_names(self) -> list[str]:
        degrees = [f"{180 * i / self.n_angles:.4g}" for i in range(self.n_angles)]
        orders = range(1, self.n_coefficients + 1)
        return ["p_sum", *(f"p_{angle}_{k}" for angle in degrees for k in orders)]
