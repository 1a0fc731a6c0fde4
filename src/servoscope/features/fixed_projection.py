"""Families of features that are the same for every set of images."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import InvalidInputError
from servoscope.features.image_transformer import ImageTransformer
from servoscope.features.pixel_blocks import brightness_gains, working_dtype
from servoscope.features.pixels import ImageShape
from servoscope.processes import one_blas_thread


class FixedProjection(ImageTransformer):
    """Projections of brightness-normalised images onto functions that no image has a say in.

    Each image is divided by its Euclidean length, as in eq. 8 of the paper, so its features do
    not change with its gain; an all-black image has features of 0. A subclass checks its
    parameters in `_prepare`, and computes in `_features`.
    """

    @abstractmethod
    def _prepare(self) -> None:
        """Check the parameters, and compute what depends on them and `image_shape_` alone."""

    @abstractmethod
    def _features(self, flat: NDArray[Any]) -> NDArray[np.float64]: ...

    def fit(self, X: Any, y: Any = None) -> Self:
        """Take note of the size of the images; nothing else is learned.

        Parameters
        ----------
        X : array of shape (n_images, height, width) or (n_images, height * width)
        y : ignored

        Returns
        -------
        Self
            Itself.
        """
        self._images_to_fit(X)
        self._prepare()
        return self

    def transform(self, X: Any) -> NDArray[np.float64]:
        """Features of images.

        Parameters
        ----------
        X : array of shape (n_images, height, width) or (n_images, height * width)

        Returns
        -------
        ndarray of shape (n_images, n_features)
        """
        return self._features(self._images_to_transform(X))


class LowOrderProjection(FixedProjection):
    """Projections onto products of a function of the column and one of the row.

    The functions are numbered by order from 0, and the products are those whose two orders sum
    to at most `order`. Images of fewer pixels a side have fewer functions, as many as pixels.
    """

    order: int
    _letter: str

    @abstractmethod
    def _basis(self, n_functions: int, n_pixels: int) -> NDArray[np.float64]:
        """The functions along one side, of shape (n_functions, n_pixels)."""

    def _prepare(self) -> None:
        check_whole_number("order", self.order, 0)

    def _features(self, flat: NDArray[Any]) -> NDArray[np.float64]:
        rows, columns = (self._basis(min(self.order + 1, n), n) for n in self.image_shape_)
        products = project_separably(flat, self.image_shape_, rows, columns)
        i, j = np.transpose(self._orders())
        return products[:, j, i]

    def _feature_names(self) -> list[str]:
        digits = len(str(self.order))
        return [f"{self._letter}_{i:0{digits}d}{j:0{digits}d}" for i, j in self._orders()]

    def _orders(self) -> list[tuple[int, int]]:
        """Orders (i, j) along x and y, the lowest sum first."""
        height, width = self.image_shape_
        sums = range(self.order + 1)
        return [(s - j, j) for s in sums for j in range(s + 1) if s - j < width and j < height]


def project_separably(
    flat: NDArray[Any],
    image_shape: ImageShape,
    rows: NDArray[np.float64],
    columns: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Projections of brightness-normalised images, ``rows @ image @ columns.T``.

    Parameters
    ----------
    flat : ndarray of shape (n_images, height * width)
    image_shape : (height, width)
    rows : ndarray of shape (n_row_functions, height)
        Functions of the row, y.
    columns : ndarray of shape (n_column_functions, width)
        Functions of the column, x.

    Returns
    -------
    ndarray of shape (n_images, n_row_functions, n_column_functions)

    Examples
    --------
    >>> image = np.array([[3.0, 0.0, 0.0, 4.0]])
    >>> project_separably(image, (2, 2), np.ones((1, 2)), np.eye(2))
    array([[[0.6, 0.8]]])
    """
    dtype = working_dtype(flat)
    gains = brightness_gains(flat)
    left, right = rows.astype(dtype), columns.T.astype(dtype)
    projections = np.empty((len(flat), len(rows), len(columns)))
    with one_blas_thread():
        for image, gain, projection in zip(flat, gains, projections, strict=True):
            normalised = image.reshape(image_shape).astype(dtype)
            normalised *= gain
            projection[:] = left @ normalised @ right
    return projections


def check_whole_number(name: str, value: Any, least: int) -> None:
    """Raise `InvalidInputError` unless a parameter is a whole number from `least`."""
    if not isinstance(value, int | np.integer) or value < least:
        raise InvalidInputError(f"{name} must be a whole number from {least}, got {value!r}.")
