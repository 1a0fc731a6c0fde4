"""What every family of moments in cells is: layers of an image, pooled in a grid of cells."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import InvalidInputError
from servoscope.features.cells import cell_names, check_n_cells
from servoscope.features.image_transformer import ImageTransformer

Floats = NDArray[np.float32]


class CellMoments(ImageTransformer):
    """Moments of order 0 of layers of an image, about each cell of a grid.

    A subclass has parameters `n_cells` and `size`, computes the layers of an image in `_cells`
    and names them in `layer_names`.
    """

    n_cells: int
    size: int
    n_rows_: int
    n_columns_: int

    @abstractmethod
    def _cells(self, image: NDArray[Any]) -> Floats:
        """What lies in the cells of an image, (n_layers, n_rows, n_columns)."""

    @abstractmethod
    def layer_names(self) -> list[str]:
        """Names of the layers, with which those of the features begin."""

    def fit(self, X: Any, y: Any = None) -> Self:
        """Take note of the size of the images; nothing else is learned.

        Parameters
        ----------
        X : array of shape (n_images, height, width) or (n_images, height * width)
        y : ignored

        Returns
        -------
        CellMoments
            Itself.
        """
        check_n_cells(self.n_cells)
        if not isinstance(self.size, int | np.integer) or self.size < 1:
            raise InvalidInputError(f"size must be a whole number from 1, got {self.size!r}.")
        self._images_to_fit(X)
        blank = np.zeros(self.image_shape_, np.uint8)
        _, self.n_rows_, self.n_columns_ = self._cells(blank).shape
        return self

    def transform(self, X: Any) -> NDArray[np.float64]:
        """Moments of images.

        Parameters
        ----------
        X : array of shape (n_images, height, width) or (n_images, height * width)

        Returns
        -------
        ndarray of shape (n_images, n_layers * n_rows_ * n_columns_)
        """
        images = self._images_to_transform(X).reshape(-1, *self.image_shape_)
        shape = len(images), len(self.layer_names()), self.n_rows_, self.n_columns_
        moments = np.empty(shape)
        for cells, image in zip(moments, images, strict=True):
            cells[:] = self._cells(image)
        return moments.reshape(len(images), -1)

    def _feature_names(self) -> list[str]:
        return cell_names(self.layer_names(), self.n_rows_, self.n_columns_)
