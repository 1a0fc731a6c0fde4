"""Gradient and intensity moments of what most of the image says that it shows."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import svd

from servoscope.errors import InvalidInputError
from servoscope.features.cells import cell_names, check_n_cells, pool_in_cells
from servoscope.features.gradient_moments import GradientMoments
from servoscope.features.image_basis import check_n_components
from servoscope.features.image_transformer import ImageTransformer
from servoscope.features.intensity_moments import IntensityMoments, intensity_cells
from servoscope.features.pixels import ImageShape
from servoscope.features.robust_projection import RobustProjection, fit_robust_projection
from servoscope.processes import one_blas_thread

Array = NDArray[np.float64]

_COARSE_COMPONENTS, _COARSE_SCALES = 40, (60.0, 30.0, 15.0, 8.0, 5.0)
_FINE_SCALES = (3.0, 2.0, 2.0, 2.0)
_GAIN_STEP, _GAIN_DIRECTIONS, _GAIN_IMAGES = 0.05, 4, 200


class RobustMoments(ImageTransformer):
    """Gradient and intensity moments, completed where the image is unlike those of training.

    Parameters
    ----------
    n_cells : int
        Cells along either side that features are told for; no more than it has pixels.
    n_components : int, optional
        Eigenvectors of the training images' cells; a third of their number by default.
    n_fine_cells : int
        Cells along either side that are completed.
    size : int
        Pixels along the longer side that larger images are shrunk to first.
    image_shape : (height, width), optional
        What flat images are; 1 x n_pixels by default.

    Attributes
    ----------
    gradient_, intensity_ : GradientMoments, IntensityMoments
        In the finer cells.
    coarse_, fine_ : RobustProjection
        What cells look like in training, by few eigenvectors and by `n_components`.
    n_rows_, n_columns_ : int
        Cells from top to bottom and from left to right.
    image_shape_ : (height, width)
    n_features_in_ : int
        Pixels of an image.

    Raises
    ------
    InvalidInputError
        If a parameter is no whole number from 1, there are not more images than `n_components`,
        an image is not of the size seen in `fit`, or a pixel is not finite.

    Notes
    -----
    An image is told by the cells of `GradientMoments` and `IntensityMoments`, in a finer grid.
    Their eigenvectors in training say what they can look like together; what covers a part of
    the view makes some of them look otherwise. `RobustProjection` finds the coefficients that
    most cells agree on, first of a few eigenvectors and with all cells in play, then of all and
    with cells dropping out. The features are what these coefficients make of the cells, pooled in
    the coarser grid; of an image as in training, nearly its own moments. Changes of what is white
    in the image, which shift all intensities, are allowed for as directions of their own.

    Examples
    --------
    >>> import cv2
    >>> pattern = cv2.GaussianBlur(np.random.default_rng(0).uniform(0, 255, (90, 130)), (0, 0), 3)
    >>> images = np.stack([pattern[8:72, i : i + 64] for i in range(60)])
    >>> covered = images[30:31].copy()
    >>> covered[:, :20, :20] = 0
    >>> robust, plain = RobustMoments().fit(images), IntensityMoments().fit(images)
    >>> changes = [
    ...     np.linalg.norm(moments.transform(covered) - moments.transform(images[30:31]))
    ...     for moments in (robust, plain)
    ... ]
    >>> bool(changes[0] < changes[1] / 5)
    True
    """

    coarse_: RobustProjection
    fine_: RobustProjection
    n_rows_: int
    n_columns_: int
    _min_images = 2

    def __init__(
        self,
        n_cells: int = 4,
        n_components: int | None = None,
        n_fine_cells: int = 16,
        size: int = 128,
        image_shape: ImageShape | None = None,
    ) -> None:
        self.n_cells = n_cells
        self.n_components = n_components
        self.n_fine_cells = n_fine_cells
        self.size = size
        self.image_shape = image_shape

    def fit(self, X: Any, y: Any = None) -> RobustMoments:
        """Learn what the cells of images look like together.

        Parameters
        ----------
        X : array of shape (n_images, height, width) or (n_images, height * width)
        y : ignored

        Returns
        -------
        RobustMoments
            Itself.
        """
        check_n_cells(self.n_cells)
        flat = self._images_to_fit(X)
        images = flat.reshape(-1, *self.image_shape_)
        n_components = self._checked_n_components(len(flat))
        self.gradient_ = GradientMoments(self.n_fine_cells, self.size).fit(images)
        self.intensity_ = IntensityMoments(self.n_fine_cells, self.size).fit(images)
        values, nuisances = self._fine_moments(flat), self._gain_directions(images)
        self.coarse_, self.fine_ = (
            fit_robust_projection(values, len(self._layer_names()), n, nuisances)
            for n in (min(_COARSE_COMPONENTS, n_components), n_components)
        )
        self.n_rows_, self.n_columns_ = self._pooled(values[:1]).shape[-2:]
        return self

    def transform(self, X: Any) -> Array:
        """Completed moments of images.

        Parameters
        ----------
        X : array of shape (n_images, height, width) or (n_images, height * width)

        Returns
        -------
        ndarray of shape (n_images, 14 * n_rows_ * n_columns_)
            Those of 8 directions, then of 6 slices of intensity.
        """
        values = self._fine_moments(self._images_to_transform(X))
        _, weights = self.coarse_.complete(values, _COARSE_SCALES)
        completed, _ = self.fine_.complete(values, _FINE_SCALES, weights)
        return self._pooled(completed).reshape(len(values), -1)

    def _checked_n_components(self, n_images: int) -> int:
        if self.n_components is None:
            return max(n_images // 3, 1)
        check_n_components(self.n_components)
        if self.n_components >= n_images:
            raise InvalidInputError(
                f"{self.n_components} eigenvectors need at least {self.n_components + 1} images, "
                f"got {n_images} (n_samples = {n_images}); lower n_components or take more images."
            )
        return self.n_components

    def _fine_moments(self, flat: NDArray[Any]) -> Array:
        """Moments in the finer cells, (n_images, n_layers * n_cells)."""
        images = flat.reshape(-1, *self.image_shape_)
        families = self.gradient_, self.intensity_
        return np.hstack([family.transform(images) for family in families])

    def _pooled(self, fine_moments: Array) -> Array:
        """Means in the coarser cells, (n_images, n_layers, n_rows, n_columns)."""
        shape = len(fine_moments), -1, self.gradient_.n_rows_, self.gradient_.n_columns_
        layers = fine_moments.reshape(shape).astype(np.float32)
        return pool_in_cells(layers, self.n_cells).astype(np.float64)

    def _gain_directions(self, images: NDArray[Any]) -> Array:
        """What moments mostly change by when what is white in the image does, by 5 %."""
        some = images[:: -(-len(images) // _GAIN_IMAGES)]
        brighter, darker = (
            [intensity_cells(image, self.size, self.n_fine_cells, gain).ravel() for image in some]
            for gain in (1 + _GAIN_STEP, 1 - _GAIN_STEP)
        )
        changes = (np.array(brighter, np.float64) - np.array(darker)) / 2
        with one_blas_thread():
            _, lengths, directions = svd(changes, full_matrices=False)
        lengths, directions = lengths[:_GAIN_DIRECTIONS], directions[:_GAIN_DIRECTIONS]
        of_intensity = directions * (lengths[:, None] / np.sqrt(len(some)))
        n_gradient = len(self.gradient_.get_feature_names_out())
        return np.pad(of_intensity, ((0, 0), (n_gradient, 0)))

    def _layer_names(self) -> list[str]:
        return [*self.gradient_.layer_names(), *self.intensity_.layer_names()]

    def _feature_names(self) -> list[str]:
        return cell_names(self._layer_names(), self.n_rows_, self.n_columns_)
