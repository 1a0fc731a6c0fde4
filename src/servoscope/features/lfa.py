"""Local feature analysis: outputs of local receptive fields, and their covariance with the pose."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from sklearn.utils.validation import check_is_fitted

from servoscope.errors import InvalidInputError
from servoscope.features.eigenfeatures import ImageBasis, fitted_basis
from servoscope.features.image_transformer import (
    ImageShape,
    ImageTransformer,
    LearnedProjection,
    check_whole_number,
    target_names,
)
from servoscope.features.normalised_images import project_images
from servoscope.processes import one_blas_thread

Array = NDArray[np.float64]


class LocalFeatureAnalysis(ImageTransformer):
    """Outputs of the local receptive fields that covary most with each degree of freedom.

    Parameters
    ----------
    n_components : int
        Number of eigenvectors that the receptive fields are made of.
    n_per_dof : int
        Number of receptive fields chosen for each degree of freedom.
    window : int
        Side of the subwindows in which covariance is gathered, [px]; even.
    image_shape : (height, width), optional
        What flat images are; 1 x n_pixels by default.
    basis : ImageBasis, optional
        Eigenvectors computed before, of which the first `n_components` are used.

    Attributes
    ----------
    basis_ : ImageBasis
        The eigenvectors in use.
    covariance_ : ndarray of shape (n_targets, height, width)
        Covariance of the LFA output at every pixel with each displacement, scaled to [-1, 1].
    filtered_ : ndarray of shape (n_targets, height, width)
        Its magnitude, averaged with the centre-weighted mask.
    locations_ : ndarray of shape (n_targets, n_per_dof, 2)
        Row and column of the receptive fields chosen, brightest first.

    Raises
    ------
    InvalidInputError
        If there are fewer independent images than `n_components`, the image has no room for
        `n_per_dof` separate subwindows.

    Notes
    -----
    Eq. 15-18 of the paper. The n_pixels x n_pixels matrix ``K = E diag(lambda^-1/2) E^T`` (eq. 16)
    is never formed: its products with images, and the few of its columns that are wanted, come from
    its factors. Eq. 18 as printed, ``Y P^T``, does not conform; ``Y P`` is meant.

    The locations follow section 4 and figure 7: the magnitude of the covariance is filtered with
    a mask of inverse distances to its centre, and the subwindows of greatest intensity are taken
    one after the other. The paper does not say whether they may overlap. Here the window slides
    by single pixels, and one that overlaps another already taken is passed over: otherwise all of
    them would crowd around one maximum. The centre of an even window lies between pixels; the
    receptive field is that of the pixel below and to the right of it.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> images = rng.integers(0, 256, (20, 16, 16), dtype=np.uint8)
    >>> delta_p = rng.uniform(-1, 1, (20, 6))
    >>> lfa = LocalFeatureAnalysis(n_components=5, n_per_dof=2, window=4).fit(images, delta_p)
    >>> lfa.transform(images).shape
    (20, 12)
    >>> lfa.get_feature_names_out()[:3]
    array(['lfa_tx_00', 'lfa_tx_01', 'lfa_ty_00'], dtype=object)
    """

    _min_images = 2
    _min_pixels = 2
    _is_supervised = True

    def __init__(
        self,
        n_components: int = 35,
        n_per_dof: int = 12,
        window: int = 12,
        image_shape: ImageShape | None = None,
        basis: ImageBasis | None = None,
    ) -> None:
        self.n_components = n_components
        self.n_per_dof = n_per_dof
        self.window = window
        self.image_shape = image_shape
        self.basis = basis

    def _check_parameters(self) -> None:
        check_whole_number("n_per_dof", self.n_per_dof, 1)

    def _learn(self, flat: NDArray[Any], targets: Array) -> None:
        self.basis_ = fitted_basis(flat, self.n_components, self.image_shape_, self.basis)
        projections = project_images(flat, self.basis_.mean, self.basis_.components)
        self.covariance_ = self._pose_covariance(projections, targets)
        self.filtered_ = np.stack(
            [filter_centre_weighted(np.abs(image), self.window) for image in self.covariance_]
        )
        self.locations_ = np.stack(
            [brightest_separate(image, self.n_per_dof, self.window) for image in self.filtered_]
        )

    def _features(self, flat: NDArray[Any]) -> Array:
        rows, columns = self.locations_.reshape(-1, 2).T
        projections = project_images(flat, self.basis_.mean, self.basis_.components)
        with one_blas_thread():
            return projections @ self._whitened(rows * self.image_shape_[1] + columns)

    def receptive_field(self, row: int, column: int) -> Array:
        """The receptive field of a pixel: its column of ``K``, as an image (height, width)."""
        check_is_fitted(self)
        height, width = self.image_shape_
        if not (0 <= row < height and 0 <= column < width):
            raise InvalidInputError(
                f"The pixel must be inside the image of {height} x {width} (height x width), "
                f"got row {row} and column {column}."
            )
        weights = self._whitened(np.array([row * width + column]))[:, 0]
        return (weights @ self.basis_.components).reshape(height, width)

    def _whitened(self, pixels: NDArray[np.intp]) -> Array:
        """What the eigenvectors are weighted with in the columns of ``K`` of these pixels."""
        return self.basis_.components[:, pixels] / np.sqrt(self.basis_.eigenvalues)[:, None]

    def _pose_covariance(self, projections: Array, delta_p: Array) -> Array:
        with one_blas_thread():
            weights = (projections.T @ delta_p) / np.sqrt(self.basis_.eigenvalues)[:, None]
            covariance = weights.T @ self.basis_.components
        largest = np.abs(covariance).max(axis=1, keepdims=True)
        covariance /= np.where(largest > 0, largest, 1.0)
        return covariance.reshape(-1, *self.image_shape_)

    def _feature_names(self) -> list[str]:
        return [
            f"lfa_{name}_{i:02d}"
            for name in target_names(len(self.locations_))
            for i in range(self.locations_.shape[1])
        ]


class LocalFeatureCovariance(LearnedProjection):
    """Projections of the LFA output onto its covariance with each degree of freedom.

    `LocalFeatureAnalysis` takes the output where this covariance is largest; these features take
    it everywhere, weighted with the covariance. The paper calls them PCLFA.

    Parameters
    ----------
    n_components : int
        Number of eigenvectors that the receptive fields are made of.
    image_shape : (height, width), optional
        What flat images are; 1 x n_pixels by default.
    basis : ImageBasis, optional
        Eigenvectors computed before, of which the first `n_components` are used.

    Attributes
    ----------
    components_ : ndarray of shape (n_targets, n_pixels)
        What images are projected onto.
    mean_ : ndarray of shape (n_pixels,)
        Mean of the normalised training images.

    Raises
    ------
    InvalidInputError
        If there are fewer independent images than `n_components`.

    Notes
    -----
    Eq. 15-18 of the paper: the output is ``y = K^T x`` with ``K = E diag(lambda^-1/2) E^T`` (eq.
    17), its covariance with the displacements ``M = K^T X P`` (eq. 18, as `LocalFeatureAnalysis`
    has it but not scaled), and the features are ``M^T y``. ``K`` acts twice in them:

    ``M^T y = P^T X^T K K^T x = P^T X^T E diag(1 / lambda_i) E^T x``,

    images being columns. So they are the least-squares estimate of the displacement from the
    first eigenfeatures: the pseudo-inverse of the interaction matrix, cut off after `n_components`
    eigenvectors.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> images = rng.integers(0, 256, (20, 8, 8), dtype=np.uint8)
    >>> delta_p = rng.uniform(-1, 1, (20, 6))
    >>> covariance = LocalFeatureCovariance(n_components=5).fit(images, delta_p)
    >>> covariance.transform(images).shape
    (20, 6)
    >>> covariance.get_feature_names_out()[[0, 5]]
    array(['pclfa_tx', 'pclfa_rz'], dtype=object)
    """

    def __init__(
        self,
        n_components: int = 85,
        image_shape: ImageShape | None = None,
        basis: ImageBasis | None = None,
    ) -> None:
        self.n_components = n_components
        self.image_shape = image_shape
        self.basis = basis

    def _learn(self, flat: NDArray[Any], targets: Array) -> None:
        basis = fitted_basis(flat, self.n_components, self.image_shape_, self.basis)
        projections = project_images(flat, basis.mean, basis.components)
        centred = targets - targets.mean(axis=0)
        with one_blas_thread():
            weights = (projections.T @ centred) / basis.eigenvalues[:, None]
            weights = weights.astype(basis.components.dtype)
            self.mean_, self.components_ = basis.mean, weights.T @ basis.components

    def _restore(self, mean: NDArray, components: NDArray) -> None:
        self.mean_, self.components_ = mean, components

    def _feature_names(self) -> list[str]:
        return [f"pclfa_{name}" for name in target_names(len(self.components_))]


def centre_weighted_mask(window: int) -> NDArray[np.float64]:
    """Square mask of inverse distances to its centre, summing to 1; its side must be even, so that
    the centre lies between pixels.

    Examples
    --------
    >>> centre_weighted_mask(2)
    array([[0.25, 0.25],
           [0.25, 0.25]])
    """
    if not isinstance(window, int | np.integer) or window < 2 or window % 2:
        raise InvalidInputError(
            "window must be an even number of pixels from 2, so that its centre lies between "
            f"pixels, got {window!r}."
        )
    offsets = np.arange(window) - (window - 1) / 2
    mask = 1 / np.hypot(offsets[:, None], offsets)
    return mask / mask.sum()


def filter_centre_weighted(image: NDArray[Any], window: int) -> NDArray[np.float64]:
    """Mean of the subwindow around each pixel, weighted by `centre_weighted_mask`.

    The value at (row, column) is of the subwindow of rows ``row - window / 2`` to
    ``row + window / 2 - 1`` and columns likewise; what it covers beyond the border counts as 0.

    Examples
    --------
    >>> filter_centre_weighted(np.ones((2, 3)), window=2)
    array([[0.25, 0.5 , 0.5 ],
           [0.5 , 1.  , 1.  ]])
    """
    mask = centre_weighted_mask(window)
    image = np.asarray(image, dtype=np.float64)
    filtered = cv2.filter2D(image, cv2.CV_64F, mask, borderType=cv2.BORDER_CONSTANT)
    return filtered.astype(np.float64, copy=False)


def brightest_separate(image: NDArray[Any], n: int, window: int) -> NDArray[np.intp]:
    """Row and column (n, 2) of the brightest pixels that are centres of subwindows which do not
    overlap. Any two are `window` pixels apart in row or in column; of equals, the first in reading
    order is taken.

    Examples
    --------
    >>> brightest_separate(np.array([[1, 9, 8, 0, 3]]), n=2, window=2).tolist()
    [[0, 1], [0, 4]]
    """
    left = np.array(image, dtype=np.float64)
    locations = np.empty((n, 2), dtype=np.intp)
    for i in range(n):
        row, column = np.unravel_index(left.argmax(), left.shape)
        if left[row, column] == -np.inf:
            raise InvalidInputError(
                f"{n} separate subwindows of {window} x {window} pixels were wanted, but only {i} "
                f"were found in an image of {left.shape[0]} x {left.shape[1]} (height x width); "
                "lower n_per_dof or window."
            )
        locations[i] = row, column
        rows = slice(max(row - window + 1, 0), row + window)
        left[rows, max(column - window + 1, 0) : column + window] = -np.inf
    return locations
