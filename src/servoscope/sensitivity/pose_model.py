"""Image features and a regressor for each degree of freedom, with the derivative of both."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.base import clone
from sklearn.utils.validation import has_fit_parameter

from servoscope.poses import DOFS
from servoscope.processes import one_blas_thread

Array = NDArray[np.float64]

_STEP = 1e-4
"""Step of differences of regressors that have no gradient, in spreads of the features."""


@dataclass(frozen=True, eq=False)
class PoseModel:
    """The displacement of the camera as told from an image.

    Parameters
    ----------
    features : transformer
        Fitted; of images.
    regressors : dict
        For each dof one with ``predict(X)``, of shape (n,), in shares of its range; where there
        is a ``gradient(X)``, of shape (n, n_features), it is used.
    ranges : ndarray of shape (6,)
        [m] and [rad].
    spreads : ndarray of shape (n_features,)
        Standard deviations of the features in training.
    """

    features: Any
    regressors: Mapping[str, Any]
    ranges: Array
    spreads: Array = field(repr=False)

    def transform(self, images: NDArray[Any]) -> Array:
        """Features of images, (n, n_features)."""
        return np.asarray(self.features.transform(images), dtype=np.float64)

    def predict(self, X: Array) -> Array:
        """Displacements told from features, (n, 6), [m] and [rad]."""
        told = [self.regressors[dof].predict(X) for dof in DOFS]
        return np.column_stack(told) * self.ranges

    def slope(self, X: Array, direction: Array) -> Array:
        """How fast `predict` changes at features X as they go along directions.

        Parameters
        ----------
        X, direction : ndarrays of shape (n, n_features)

        Returns
        -------
        ndarray of shape (n, 6)
            [m] and [rad], for each time that the direction is gone along.
        """
        slopes = [self._slope_of(self.regressors[dof], X, direction) for dof in DOFS]
        return np.column_stack(slopes) * self.ranges

    def _slope_of(self, regressor: Any, X: Array, direction: Array) -> Array:
        if hasattr(regressor, "gradient"):
            return np.asarray(np.einsum("ij,ij->i", regressor.gradient(X), direction))
        size = np.abs(direction / np.where(self.spreads > 0, self.spreads, np.inf)).max(axis=1)
        h = _STEP / np.where(size > 0, size, 1.0)
        ahead = regressor.predict(X + h[:, None] * direction)
        behind = regressor.predict(X - h[:, None] * direction)
        return np.asarray((ahead - behind) / (2 * h))


def fit_pose_model(
    images: NDArray[np.uint8], delta_p: Array, ranges: Array, features: Any, regressor: Any
) -> PoseModel:
    """Fit image features, and a regressor for each dof to targets in shares of the range.

    Parameters
    ----------
    images : ndarray of shape (n, height, width)
    delta_p : ndarray of shape (n, 6)
        [m] and [rad], in `DOFS` order.
    ranges : ndarray of shape (6,)
        [m] and [rad].
    features : transformer
        Its ``fit`` is given the images and their targets; a copy is fitted.
    regressor : estimator
        Cloned for each dof.
    """
    targets = delta_p / ranges
    with one_blas_thread():
        fitted = clone(features).fit(images, targets)
        X = np.asarray(fitted.transform(images), dtype=np.float64)
        regressors = {dof: _fit(clone(regressor), X, targets[:, i]) for i, dof in enumerate(DOFS)}
    return PoseModel(fitted, regressors, ranges, X.std(axis=0))


def _fit(regressor: Any, X: Array, y: Array) -> Any:
    """Fit to all samples; the last fifth of them stops those that know what to do with it."""
    if not has_fit_parameter(regressor, "X_val"):
        return regressor.fit(X, y)
    n_train = len(y) - len(y) // 5
    return regressor.fit(X[:n_train], y[:n_train], X[n_train:], y[n_train:])
