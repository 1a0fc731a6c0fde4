"""Whitened pose-image covariance: what inverts the interaction matrix of whole images."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve

from servoscope.errors import InvalidInputError
from servoscope.features.learned_projection import LearnedProjection
from servoscope.features.pixels import ImageShape
from servoscope.features.pose_products import centred_targets, product_names
from servoscope.features.snapshots import mean_and_gram, rounding_variance, sum_images
from servoscope.processes import one_blas_thread

Array = NDArray[np.float64]


class WhitenedPoseCovariance(LearnedProjection):
    """Ridge estimates of the displacement that are linear in the image.

    Parameters
    ----------
    ridge : float
        What is added to the variance of the training images in every direction, as a share of
        the mean variance of the directions in which they vary.
    products : bool
        Whether there are features for the products of two displacements as well.
    image_shape : (height, width), optional
        What flat images are; 1 x n_pixels by default.

    Attributes
    ----------
    components_ : ndarray of shape (n_features, n_pixels)
        What images are projected onto.
    mean_ : ndarray of shape (n_pixels,)
        Mean of the normalised training images.
    n_targets_ : int
    image_shape_ : (height, width)
    n_features_in_ : int
        Pixels of an image.

    Raises
    ------
    InvalidInputError
        If `ridge` is not a positive number, there are not as many displacements as images, an
        image is not of the size seen in `fit`, or a number is not finite.

    Notes
    -----
    With the normalised, centred images of eq. 9 of [1]_ as rows of ``X``, and displacements ``P``
    about their mean, the components are the rows of

    ``W^T = ((X^T X + r I)^-1 X^T P)^T = (E diag(1 / (lambda_i + r)) E^T X^T P)^T``,

    ``E`` being the eigenvectors and ``lambda_i`` the eigenvalues of eq. 10. Pose-image covariance
    (eq. 13) is ``X^T P`` alone: here each of its coordinates in eigenvectors is divided by the
    variance there, so that the degrees of freedom are told apart instead of each taking what the
    strongest changes of the image share with it. As ``r`` grows, the features become those of
    `PoseImageCovariance` but for scale; as it falls to 0, the least-squares estimate of the
    displacement. They are in its units, [m] and [rad].

    If images were linear in the pose, ``x = x0 + L p + noise``, with poses drawn independently
    with variance ``s^2`` for each degree of freedom (isotropic sampling), then ``X^T P = n s^2 L``
    and ``X^T X = n s^2 L L^T + n q^2 I`` for white noise of variance ``q^2``. Hence
    ``W^T = (L^T L + rho I)^-1 L^T`` with ``rho = (q^2 + r / n) / s^2``: the regularised
    pseudo-inverse ``L^+`` of the interaction matrix, with which image-based control multiplies an
    error of images; pose-image covariance is its transpose ``L^T``. Ranges that differ weigh the
    degrees of freedom: ``S (S L^T L S + rho' I)^-1 S L^T``, which is still ``L^+`` as ``r`` and
    the noise vanish.

    The inverse is taken in the space of the images, ``X^T (X X^T + r I)^-1 P``.

    References
    ----------
    .. [1] G. Wells and C. Torras, "Assessing image features for vision-based robot positioning",
       Journal of Intelligent and Robotic Systems 30 (2001), 95-118.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> images = rng.integers(0, 256, (20, 8, 8), dtype=np.uint8)
    >>> delta_p = rng.uniform(-1, 1, (20, 6))
    >>> whitened = WhitenedPoseCovariance(ridge=1e-6).fit(images, delta_p)
    >>> estimates = whitened.transform(images) + delta_p.mean(axis=0)
    >>> np.allclose(estimates, delta_p, atol=1e-3)
    True
    >>> whitened.get_feature_names_out()[[0, 5]]
    array(['pwi_tx', 'pwi_rz'], dtype=object)
    """

    def __init__(
        self,
        ridge: float = 0.1,
        products: bool = False,
        image_shape: ImageShape | None = None,
    ) -> None:
        self.ridge = ridge
        self.products = products
        self.image_shape = image_shape

    def fit(self, X: Any, y: Any) -> WhitenedPoseCovariance:
        """Regress displacements on images.

        Parameters
        ----------
        X : array of shape (n_images, height, width) or (n_images, height * width)
        y : array of shape (n_images, n_targets) or (n_images,)
            Displacement of each image from the reference, [m] and [rad], in `DOFS` order if
            there are six.

        Returns
        -------
        WhitenedPoseCovariance
            Itself.
        """
        _check_ridge(self.ridge)
        flat, delta_p = self._images_and_targets_to_fit(X, y)
        self.n_targets_ = delta_p.shape[1]
        self.mean_, gram = mean_and_gram(flat)
        targets = centred_targets(delta_p, self.products)
        if np.trace(gram) <= len(flat) * rounding_variance(flat, 0.0):
            targets[:] = 0  # nothing can be told from images that do not vary
        weights = _ridge_weights(gram, targets, self.ridge)
        self.components_ = sum_images(flat, self.mean_, weights)
        return self

    def _feature_names(self) -> list[str]:
        return [f"pwi_{name}" for name in product_names(self.n_targets_, self.products)]


def _check_ridge(ridge: Any) -> None:
    if not isinstance(ridge, float | int | np.floating) or not 0 < ridge < np.inf:
        raise InvalidInputError(f"ridge must be a positive number, got {ridge!r}.")


def _ridge_weights(gram: Array, targets: Array, ridge: float) -> Array:
    """``(gram + r I)^-1 targets``; 0 for targets of 0."""
    if not targets.any():
        return targets
    level = ridge * np.trace(gram) / (len(gram) - 1)
    regularised = gram + level * np.eye(len(gram))
    with one_blas_thread():
        return np.asarray(solve(regularised, targets, assume_a="pos"))
