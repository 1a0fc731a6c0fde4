"""
Two families of features, one of them learned
=============================================

Image features of one's own, tried beside those that are built in::

    .venv/bin/python examples/more_features.py FOLDER

FOLDER is a data set, as ``servoscope acquire`` and ``servoscope import`` write it. Cosines are the
same functions of every image; the ridge estimates are learned from images and displacements. Both
were tried in the assessment of families (docs/features.md) and are behind what is built in. Entry
points bring such classes to the command line: docs/plugins.md.
"""

# sphinx_gallery_thumbnail_path = "images/families.png"

import sys

import numpy as np
from sklearn.base import BaseEstimator, TransformerMixin

import servoscope as sv
from servoscope.pipeline import forecast
from servoscope.poses import DISPLAY_FACTORS


def unit_length(images):
    """Images as rows of unit length, so that gain does not change them; black stays black."""
    rows = np.asarray(images, dtype=np.float64).reshape(len(images), -1)
    lengths = np.linalg.norm(rows, axis=1, keepdims=True)
    return np.divide(rows, lengths, out=np.zeros_like(rows), where=lengths > 0)


class CosineCoefficients(TransformerMixin, BaseEstimator):
    """The low end of the two-dimensional cosine transform of type II.

    ``c_ij`` has i half waves along the columns and j along the rows, ``i + j <= order``.
    """

    is_learned = False

    def __init__(self, order=7):
        self.order = order

    def fit(self, images, displacements=None):
        height, width = np.shape(images)[1:]
        self.orders_ = [(s - j, j) for s in range(self.order + 1) for j in range(s + 1)]
        across, down = (self._waves(n) for n in (width, height))
        self.components_ = np.array([np.outer(down[j], across[i]).ravel() for i, j in self.orders_])
        return self

    def transform(self, images):
        return unit_length(images) @ self.components_.T

    def get_feature_names_out(self, input_features=None):
        return np.array([f"c_{i}{j}" for i, j in self.orders_], dtype=object)

    def _waves(self, n_pixels):
        angles = np.pi * np.outer(np.arange(self.order + 1), np.arange(n_pixels) + 0.5) / n_pixels
        waves = np.cos(angles) * np.sqrt(2 / n_pixels)
        waves[0] /= np.sqrt(2)
        return waves


class RidgeEstimates(TransformerMixin, BaseEstimator):
    """Estimates of the displacement that are linear in the image, by ridge regression.

    If images were linear in the pose, ``x = x0 + L p + noise``, these would be the damped
    pseudo-inverse of the interaction matrix, ``(L'L + rho I)^-1 L'``, where pose-image covariance
    is its transpose.
    """

    def __init__(self, ridge=0.1):
        self.ridge = ridge

    def fit(self, images, displacements):
        rows, targets = unit_length(images), np.asarray(displacements, dtype=np.float64)
        self.mean_ = rows.mean(axis=0)
        rows -= self.mean_
        products = rows @ rows.T
        level = self.ridge * np.trace(products) / (len(rows) - 1) or 1.0
        weights = np.linalg.solve(
            products + level * np.eye(len(rows)), targets - targets.mean(axis=0)
        )
        self.components_ = weights.T @ rows
        return self

    def transform(self, images):
        return (unit_length(images) - self.mean_) @ self.components_.T

    def get_feature_names_out(self, input_features=None):
        return np.array([f"ridge_{i}" for i in range(len(self.components_))], dtype=object)

    def to_arrays(self):
        """What is learned, for a pipeline that is saved."""
        return {"mean": self.mean_, "components": self.components_}

    @classmethod
    def from_arrays(cls, arrays):
        features = cls()
        features.mean_, features.components_ = arrays["mean"], arrays["components"]
        return features


def main(folder):
    data = sv.PoseImageSet.load(folder)
    families = ["moments", "intensity", CosineCoefficients(), RidgeEstimates()]
    targets = data.delta_p()
    table = sv.FeatureTable.fit(data.images, targets, families, n_folds=5)
    print("forecast RMS error in mm and degrees")
    print(f"{'family':20}{''.join(f'{dof:>8}' for dof in sv.DOFS)}")
    for name in dict.fromkeys(table.families):
        rms = forecast(table, targets, None, sv.Recipe(name)).rms * DISPLAY_FACTORS
        print(f"{name:20}{''.join(f'{error:8.3f}' for error in rms)}")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main(sys.argv[1])
