"""Completed cells: moments in cells, corrected where an image is unlike those of training."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import LinAlgError, eigh, lapack, svd
from sklearn.utils.validation import check_is_fitted

from servoscope.errors import InvalidInputError
from servoscope.features.cell_moments import (
    GradientMoments,
    IntensityMoments,
    cell_names,
    intensity_cells,
    pool_in_cells,
)
from servoscope.features.image_transformer import ImageShape, ImageTransformer, check_whole_number
from servoscope.processes import one_blas_thread
from servoscope.storage.stacks import Stack

Array = NDArray[np.float64]

_SCALE_DEVIATION = 0.3

_LEAST_SQUARE = 1e-12
"""Eigenvalues of less than that share of the largest are rounding."""


@dataclass(frozen=True, eq=False)
class RobustProjection:
    """Projection onto the leading eigenvectors by what is not out of the ordinary.

    Parameters
    ----------
    mean : ndarray of shape (n_values,)
    components : ndarray of shape (n_components, n_values)
        Eigenvectors, each as long as its projections deviate in training.
    nuisances : ndarray of shape (n_nuisances, n_values)
        What else values may change by, of a standard deviation.
    noise : ndarray of shape (n_values,)
        Standard deviation of what the eigenvectors leave of training values.
    n_layers : int
        Values are of the shape (n_layers, n_places), flattened.

    Notes
    -----
    Values are modelled as ``a (mean + u E) + v N + noise`` with ``u`` and ``v`` standard normal
    and ``a`` of standard deviation 0.3 about 1, and the most probable ``a``, ``u`` and ``v`` are
    found by iteratively reweighted least squares. Places count by the weight of Geman and McClure
    ``(t^2 / (t^2 + r^2))^2``, ``r^2`` being the mean squared residual of their layers in units of
    the noise and ``t`` a scale that shrinks from one iteration to the next, as in [1]_ and [2]_;
    so all layers of a place drop out together.

    References
    ----------
    .. [1] M. J. Black and A. D. Jepson, "EigenTracking: robust matching and tracking of
       articulated objects using a view-based representation", International Journal of Computer
       Vision 26 (1998), 63-84.
    .. [2] A. Leonardis and H. Bischof, "Robust recognition using eigenimages", Computer Vision and
       Image Understanding 78 (2000), 99-118.
    """

    mean: Array
    components: Array
    nuisances: Array
    noise: Array
    n_layers: int

    def complete(
        self, values: Array, scales: Sequence[float], weights: Array | None = None
    ) -> tuple[Array, Array]:
        """Values (n, n_values) as the eigenvectors have them, and how much each place (n, n_places)
        counts. `scales` has the ``t`` of each iteration, `weights` what places count to begin with,
        1 by default.
        """
        n_places = len(self.mean) // self.n_layers
        if weights is None:
            weights = np.ones((len(values), n_places))
        with one_blas_thread():
            for scale in scales:
                solution = self._solve(values, weights)
                residuals = values / self.noise - solution @ self._design
                squares = np.square(residuals).reshape(-1, self.n_layers, n_places).mean(axis=1)
                weights = (scale**2 / (scale**2 + squares)) ** 2
            return self._without_nuisances(solution), weights

    ARRAYS: ClassVar[tuple[str, ...]] = ("mean", "components", "nuisances", "noise")

    def to_arrays(self) -> dict[str, Array]:
        """The arrays that make it."""
        return {name: getattr(self, name) for name in self.ARRAYS}

    @classmethod
    def from_arrays(
        cls, arrays: Mapping[str, ArrayLike], n_layers: int, n_values: int
    ) -> RobustProjection:
        """The projection of arrays, for so many layers and values."""
        mean, components, nuisances, noise = (
            np.asarray(arrays[name], dtype=np.float64) for name in cls.ARRAYS
        )
        shapes = {mean.shape, components.shape[1:], nuisances.shape[1:], noise.shape}
        if shapes != {(n_values,)} or not (noise > 0).all():
            raise InvalidInputError(
                f"The arrays of a robust projection must be of {n_values} values each, with noise "
                f"above 0, got the shapes {sorted(map(str, shapes))}."
            )
        return cls(mean, components, nuisances, noise, n_layers)

    def __getstate__(self) -> dict[str, Any]:
        """Without what follows from the fields, which takes more room than they do."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @cached_property
    def _design(self) -> Array:
        """What values are a sum of, in units of the noise."""
        rows = np.vstack([_SCALE_DEVIATION * self.mean, self.components, self.nuisances])
        return rows / self.noise

    def _solve(self, values: Array, weights: Array) -> Array:
        n_rows = len(self._design)
        expected = np.zeros(n_rows)
        expected[0] = 1 / _SCALE_DEVIATION
        weighted = values / self.noise * np.tile(weights, self.n_layers)
        right = weighted @ self._design.T + expected
        packed, upper = weights @ _grams(self), _upper(n_rows)
        left, solutions = np.zeros((n_rows, n_rows)), np.empty_like(right)
        for solution, products, on_the_right in zip(solutions, packed, right, strict=True):
            left[upper] = products
            left.flat[:: n_rows + 1] += 1
            solution[:] = _solve_positive(left, on_the_right)
        return solutions

    def _without_nuisances(self, solution: Array) -> Array:
        """``mean + u E`` of solutions, ``a`` being kept away from 0."""
        factor = np.maximum(_SCALE_DEVIATION * solution[:, :1], 0.1)
        return self.mean + solution[:, 1 : 1 + len(self.components)] / factor @ self.components


@lru_cache(maxsize=2)
def _grams(projection: RobustProjection) -> Array:
    """Inner products of the rows of the design in each place, a row of a triangle each.

    They take more room than all else of a projection, and are kept for the two used last.
    """
    design, n_layers = projection._design, projection.n_layers
    upper = _upper(len(design))
    by_place = design.reshape(len(design), n_layers, -1).transpose(2, 0, 1)
    grams = np.empty((len(by_place), int(upper.sum())))
    for row, place in zip(grams, by_place, strict=True):
        row[:] = (place @ place.T)[upper]
    return grams


def _upper(n_rows: int) -> NDArray[np.bool_]:
    """Where the upper triangle of a matrix is."""
    return np.tri(n_rows, dtype=bool).T


def fit_robust_projection(
    values: Array, n_layers: int, n_components: int, nuisances: Array
) -> RobustProjection:
    """The `RobustProjection` of training values, (n, n_layers * n_places), with nuisances of that
    width. Of the components, less than n, fewer are used where values do not vary in as many
    directions.
    """
    n = len(values)
    mean = values.mean(axis=0)
    with one_blas_thread():
        left = values - mean
        squares, directions = eigh(left @ left.T, overwrite_a=True)
        squares, directions = squares[::-1][:n_components], directions[:, ::-1][:, :n_components]
        varies = squares > _LEAST_SQUARE * squares[0]
        lengths = np.sqrt(squares[varies])
        vectors = directions[:, varies].T @ left / lengths[:, None]
        n_components = len(vectors)
        left -= left @ vectors.T @ vectors
    variances = (left**2).sum(axis=0) / (n - n_components)
    rounding = 1e-6 * float(np.square(values).mean()) or 1.0
    noise = np.sqrt(variances + np.median(variances) + rounding)
    components = vectors * (lengths[:, None] / np.sqrt(n))
    return RobustProjection(mean, components, nuisances, noise, n_layers)


def _solve_positive(left: Array, right: Array) -> Array:
    """The solution by the upper triangle of `left`, which is overwritten."""
    _, solution, info = lapack.dposv(left.T, right, lower=1, overwrite_a=1)
    if info != 0:
        raise LinAlgError("The normal equations are not positive definite.")
    return solution


_MOST_OF_STACK, _BLOCK = 1500, 50
_MOST_COMPONENTS = 256
_COARSE_COMPONENTS, _COARSE_SCALES = 40, (60.0, 30.0, 15.0, 8.0, 5.0)
_FINE_SCALES = (3.0, 2.0, 2.0, 2.0)
_GAIN_STEP, _GAIN_DIRECTIONS, _GAIN_IMAGES = 0.05, 4, 200


class RobustMoments(ImageTransformer):
    """Gradient and intensity moments, completed where the image is unlike those of training.

    Parameters
    ----------
    n_cells : int
        Cells along either side that features are given for; no more than it has pixels.
    n_components : int, optional
        Eigenvectors of the training images' cells; a third of their number by default, and 256 at
        the most: memory grows with the square.
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
        The cells of the training images, by few eigenvectors and by `n_components`.
    n_rows_, n_columns_ : int
        Cells from top to bottom and from left to right.

    Raises
    ------
    InvalidInputError
        If a parameter is no whole number from 1, there are not more images than `n_components`.

    Notes
    -----
    An image is described by the cells of `GradientMoments` and `IntensityMoments`, in a finer grid.
    Their eigenvectors in training span how they vary together; what covers a part of the view
    moves some of them off that span. `RobustProjection` finds the coefficients that
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

    def _check_parameters(self) -> None:
        check_whole_number("n_cells", self.n_cells, 1)

    def _learn(self, flat: NDArray[Any], targets: Any) -> None:
        if isinstance(flat, Stack):
            even = np.linspace(0, len(flat) - 1, min(len(flat), _MOST_OF_STACK)).round()
            flat = flat[even.astype(np.intp)]
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

    def _features(self, flat: NDArray[Any]) -> Array:
        return np.concatenate(
            [
                self._features_of_block(flat[start : start + _BLOCK])
                for start in range(0, len(flat), _BLOCK)
            ]
        )

    def _features_of_block(self, flat: NDArray[Any]) -> Array:
        values = self._fine_moments(flat)
        _, weights = self.coarse_.complete(values, _COARSE_SCALES)
        completed, _ = self.fine_.complete(values, _FINE_SCALES, weights)
        return self._pooled(completed).reshape(len(values), -1)

    def to_arrays(self) -> dict[str, NDArray]:
        """What was learned, as plain arrays of numbers.

        Raises
        ------
        NotFittedError
            If nothing was.
        """
        check_is_fitted(self)
        return {
            "settings": np.array([*self.image_shape_, self.n_cells, self.n_fine_cells, self.size]),
            "brightest": np.array([self.grey_scale_, self.brightest_]),
            **{f"coarse.{name}": array for name, array in self.coarse_.to_arrays().items()},
            **{f"fine.{name}": array for name, array in self.fine_.to_arrays().items()},
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, ArrayLike]) -> RobustMoments:
        """Features as those that `to_arrays` was called on."""
        height, width, n_cells, n_fine_cells, size = map(int, np.asarray(arrays["settings"]))
        check_whole_number("n_cells", n_cells, 1)
        features = cls(n_cells=n_cells, n_fine_cells=n_fine_cells, size=size)
        black = np.zeros((2, height, width), np.uint8)
        flat = features._images_to_fit(black)
        features.grey_scale_, features.brightest_ = map(float, np.asarray(arrays["brightest"]))
        features.gradient_ = GradientMoments(n_fine_cells, size).fit(black)
        features.intensity_ = IntensityMoments(n_fine_cells, size).fit(black)
        values, n_layers = features._fine_moments(flat), len(features._layer_names())
        features.coarse_, features.fine_ = (
            RobustProjection.from_arrays(
                {name: arrays[f"{stage}.{name}"] for name in RobustProjection.ARRAYS},
                n_layers,
                values.shape[1],
            )
            for stage in ("coarse", "fine")
        )
        features.n_rows_, features.n_columns_ = features._pooled(values).shape[-2:]
        return features

    def _checked_n_components(self, n_images: int) -> int:
        if self.n_components is None:
            return min(max(n_images // 3, 1), _MOST_COMPONENTS)
        check_whole_number("n_components", self.n_components, 1)
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
