"""A pipeline from images to displacements, with the derivative of its predictions."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.data.splits import Split
from servoscope.pipeline import FeatureTable, Fitted, PosePipeline, Recipe, fit_all
from servoscope.poses import DOFS

Array = NDArray[np.float64]

_STEP = 1e-4
"""Step of differences of regressors that have no gradient, in spreads of the features."""


@dataclass(frozen=True, eq=False)
class PoseModel:
    """The displacement of the camera as predicted from an image, and its derivative.

    Parameters
    ----------
    pipeline : PosePipeline
        Of all six dofs. Where a regressor has a ``gradient(X)``, of shape (n, n_features), it is
        used.
    spreads : ndarray of shape (n_features,)
        Standard deviations of the features in training.
    """

    pipeline: PosePipeline
    spreads: Array = field(repr=False)

    def transform(self, images: NDArray[Any]) -> Array:
        """Features of images, (n, n_features)."""
        return self.pipeline.compute_features(images)

    def predict(self, X: Array) -> Array:
        """Displacements predicted from features, (n, 6), [m] and [rad]."""
        return self.pipeline.predict_from(X)[0]

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
        slopes = [self._slope_of(one, X, direction) for one in self.pipeline.regressors_.values()]
        return np.column_stack(slopes) * self.pipeline.ranges_

    def _slope_of(self, fitted: Fitted, X: Array, direction: Array) -> Array:
        regressor, columns = fitted.regressor, fitted.columns
        X, direction, spreads = X[:, columns], direction[:, columns], self.spreads[columns]
        if hasattr(regressor, "gradient"):
            return np.asarray(np.einsum("ij,ij->i", regressor.gradient(X), direction))
        size = np.abs(direction / np.where(spreads > 0, spreads, np.inf)).max(axis=1)
        h = _STEP / np.where(size > 0, size, 1.0)
        ahead = regressor.predict(X + h[:, None] * direction)
        behind = regressor.predict(X - h[:, None] * direction)
        return np.asarray((ahead - behind) / (2 * h))


def fit_pose_model(
    images: NDArray[np.uint8], delta_p: Array, ranges: Array, recipe: Recipe
) -> PoseModel:
    """Fit a recipe for each dof to targets in shares of the range.

    The last fifth of the images stops networks.

    Parameters
    ----------
    images : ndarray of shape (n, height, width)
    delta_p : ndarray of shape (n, 6)
        [m] and [rad], in `DOFS` order.
    ranges : ndarray of shape (6,)
        [m] and [rad].
    recipe : Recipe
    """
    n, targets = len(images), delta_p / ranges
    split = Split(np.arange(n - n // 5), np.arange(n - n // 5, n), np.arange(0))
    table = FeatureTable.fit(images, targets, recipe.families, n_jobs=1)
    fitted = fit_all(table, targets, split, [(recipe, dof) for dof in DOFS], n_jobs=1)
    pipeline = PosePipeline.from_fitted(table, fitted, ranges, split, images[0])
    return PoseModel(pipeline, table.values.std(axis=0))
