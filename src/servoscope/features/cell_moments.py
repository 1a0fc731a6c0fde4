"""Moments of layers of an image in cells: gradient orientations, intensity slices."""

from __future__ import annotations

from abc import abstractmethod
from functools import cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from servoscope.compiled import compiled
from servoscope.data.image_motion import shrink
from servoscope.features.image_transformer import ImageShape, ImageTransformer, check_whole_number

Floats = NDArray[np.float32]


_WIDTH = 0.6
"""Standard deviation of a cell's weights, in cells."""


def pool_in_cells(layers: Floats, n_cells: int) -> Floats:
    """Mean of each layer (..., height, width) about each cell of a grid, by Gaussian weights,
    float32. There are `n_cells` along either side, but no more than pixels.

    Examples
    --------
    >>> pool_in_cells(np.ones((5, 12, 2), np.float32), n_cells=4).shape
    (5, 4, 2)
    """
    rows, columns = (cell_weights(side, n_cells) for side in layers.shape[-2:])
    return np.asarray(rows @ layers @ columns.T, dtype=np.float32)


def cell_names(layers: list[str], n_rows: int, n_columns: int) -> list[str]:
    """Names of the cells of layers, in the order of their values flattened.

    Examples
    --------
    >>> cell_names(["a", "b"], n_rows=1, n_columns=2)
    ['a_0_0', 'a_0_1', 'b_0_0', 'b_0_1']
    """
    cells = [f"{row}_{column}" for row in range(n_rows) for column in range(n_columns)]
    return [f"{layer}_{cell}" for layer in layers for cell in cells]


@cache
def cell_weights(size: int, n_cells: int) -> Floats:
    """Weights of the pixels along a side for each of the cells along it, (n_cells, size)."""
    n_cells = min(n_cells, size)
    centres = (np.arange(n_cells) + 0.5) * size / n_cells
    away = (np.arange(size) + 0.5 - centres[:, None]) / (_WIDTH * size / n_cells)
    weights = np.exp(-0.5 * away**2)
    return (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32)


N_DIRECTIONS = 8

BLUR = 0.8


def orientation_cells(image: NDArray[Any], size: int, n_cells: int) -> Floats:
    """How much slope there is in each of 8 directions about each cell, (8, n_rows, n_columns),
    float32. Direction i is i times 45 degrees, from x, along the columns, towards y, down the rows.

    Each slope, over its magnitude and twice the mean one, counts for the directions within 90
    degrees of its own by the squared cosine, and for cells by a Gaussian. What comes back is the
    square root of each share in the whole, so that all of them together have unit length.

    Examples
    --------
    >>> ramp = np.arange(64, dtype=np.uint8) * np.ones((64, 1), np.uint8)
    >>> orientation_cells(ramp, size=64, n_cells=3).sum(axis=(1, 2)).argmax()
    np.int64(0)
    """
    small = cv2.GaussianBlur(shrink(image, size), (0, 0), BLUR)
    layers = np.empty((N_DIRECTIONS, *small.shape), np.float32)
    _write_orientations(cv2.Sobel(small, -1, 1, 0), cv2.Sobel(small, -1, 0, 1), layers)
    pooled = np.maximum(pool_in_cells(layers, n_cells), 0)
    total = pooled.sum()
    return np.sqrt(pooled / total) if total > 0 else pooled


@compiled(fastmath=True, error_model="numpy")
def _write_orientations(right: Floats, down: Floats, layers: Floats) -> None:
    """Write how much slope there is in each direction: squared cosine times magnitude.

    Slopes count over their magnitude and twice its mean: neither gain nor offset changes them, and
    something that covers the view or shines changes only those beside it, but for the mean. They
    are 0 throughout an image without anything in it.
    """
    n_rows, n_columns = right.shape
    total = 0.0
    for row in range(n_rows):
        for column in range(n_columns):
            x, y = right[row, column], down[row, column]
            total += np.sqrt(x * x + y * y)
    twice_mean = np.float32(2 * total / right.size)
    for k in range(len(layers)):
        angle = 2 * np.pi * k / len(layers)
        cosine, sine = np.float32(np.cos(angle)), np.float32(np.sin(angle))
        for row in range(n_rows):
            for column in range(n_columns):
                x, y = right[row, column], down[row, column]
                magnitude = np.sqrt(x * x + y * y)
                along = max(cosine * x + sine * y, np.float32(0))
                whole = magnitude * (magnitude + twice_mean)
                layers[k, row, column] = along * along / whole if whole > 0 else np.float32(0)


class CellMoments(ImageTransformer):
    """Moments of order 0 of layers of an image, about each cell of a grid.

    A subclass computes the layers of an image in `_cells` and names them in `layer_names`.

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
    """

    n_rows_: int
    n_columns_: int

    def __init__(
        self, n_cells: int = 6, size: int = 128, image_shape: ImageShape | None = None
    ) -> None:
        self.n_cells = n_cells
        self.size = size
        self.image_shape = image_shape

    @abstractmethod
    def _cells(self, image: NDArray[Any]) -> Floats:
        """What lies in the cells of an image, (n_layers, n_rows, n_columns)."""

    @abstractmethod
    def layer_names(self) -> list[str]:
        """Names of the layers, with which those of the features begin."""

    def _check_parameters(self) -> None:
        check_whole_number("n_cells", self.n_cells, 1)
        check_whole_number("size", self.size, 1)

    def _learn(self, flat: NDArray[Any], targets: Any) -> None:
        blank = np.zeros(self.image_shape_, np.uint8)
        _, self.n_rows_, self.n_columns_ = self._cells(blank).shape

    def _features(self, flat: NDArray[Any]) -> NDArray[np.float64]:
        images = flat.reshape(-1, *self.image_shape_)
        shape = len(images), len(self.layer_names()), self.n_rows_, self.n_columns_
        moments = np.empty(shape)
        for cells, image in zip(moments, images, strict=True):
            cells[:] = self._cells(image)
        return moments.reshape(len(images), -1)

    def _feature_names(self) -> list[str]:
        return cell_names(self.layer_names(), self.n_rows_, self.n_columns_)


class GradientMoments(CellMoments):
    """How much slope there is in each of 8 directions about each cell of an image.

    Parameters and attributes are those of `CellMoments`.

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

    def _cells(self, image: NDArray[Any]) -> Floats:
        return orientation_cells(image, self.size, self.n_cells)

    def layer_names(self) -> list[str]:
        return [f"o{360 * i // N_DIRECTIONS:03d}" for i in range(N_DIRECTIONS)]


LEVELS = np.linspace(0.1, 1.1, 6, dtype=np.float32)
"""Grey levels that the slices lie about, in units of what is white in the image."""

WHITE_QUANTILE = 0.8


class IntensityMoments(CellMoments):
    """How much of each cell of an image lies in each of 6 soft slices of intensity.

    Parameters and attributes are those of `CellMoments`.

    Notes
    -----
    `GeometricMoments` cuts an image into slices of intensity (section 3.1 of the paper) and takes
    moments up to order 3 of each. Here the slices overlap, a grey level counting for the two
    nearest of 6 levels, more for the nearer, so that features change smoothly; their moments of
    order 0 are taken under Gaussian windows, a grid of them, and the square root of each cell's
    share is the feature. Grey levels are in units of the 80 % quantile of the image, which
    something that covers a small part of the view hardly moves. Gain changes nothing as long as no
    pixel saturates; an offset and a light that falls off do.

    Examples
    --------
    >>> images = np.random.default_rng(0).integers(0, 100, (3, 64, 64), dtype=np.uint8)
    >>> moments = IntensityMoments(n_cells=2).fit(images)
    >>> np.allclose(moments.transform(2 * images), moments.transform(images), atol=1e-5)
    True
    >>> moments.get_feature_names_out()[[0, 1, 23]]
    array(['i010_0_0', 'i010_0_1', 'i110_1_1'], dtype=object)
    """

    def _cells(self, image: NDArray[Any]) -> Floats:
        return intensity_cells(image, self.size, self.n_cells)

    def layer_names(self) -> list[str]:
        return intensity_names()


def intensity_cells(image: NDArray[Any], size: int, n_cells: int, gain: float = 1.0) -> Floats:
    """How much of each cell of an image lies in each of the soft slices about `LEVELS`, (6, n_rows,
    n_columns). Square roots of shares that sum to 1 in each cell; the outer slices take what is
    beyond. The image is multiplied with `gain` after its white was determined.

    Examples
    --------
    >>> intensity_cells(np.full((8, 8), 70, np.uint8), size=8, n_cells=1)[:, 0, 0].round(2)
    array([0.  , 0.  , 0.  , 0.  , 0.71, 0.71], dtype=float32)
    """
    small = cv2.GaussianBlur(shrink(image, size), (0, 0), BLUR)
    white = float(np.quantile(small, WHITE_QUANTILE))
    layers = np.zeros((len(LEVELS), *small.shape), np.float32)
    if white > 0:
        _write_slices(small, np.float32(gain / white), LEVELS, layers)
    else:
        layers[0] = 1
    return np.sqrt(pool_in_cells(layers, n_cells))


@compiled(fastmath=True, error_model="numpy")
def _write_slices(grey: Floats, scale: np.float32, levels: Floats, layers: Floats) -> None:
    """Write how much of each pixel is of each level: shares of the two that it lies between."""
    first, last = levels[0], levels[-1]
    step = levels[1] - levels[0]
    for k in range(len(levels)):
        for row in range(grey.shape[0]):
            for column in range(grey.shape[1]):
                value = min(max(grey[row, column] * scale, first), last)
                away = abs(value - levels[k]) / step
                layers[k, row, column] = max(np.float32(1) - away, np.float32(0))


def intensity_names() -> list[str]:
    """Names of the slices, by their level in hundredths of white."""
    return [f"i{round(100 * level):03d}" for level in LEVELS.tolist()]
