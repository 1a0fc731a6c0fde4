"""What linear families are: projections of brightness-normalised images, fixed or learned."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.utils.validation import check_is_fitted

from servoscope.errors import InvalidInputError
from servoscope.features.image_transformer import ImageTransformer
from servoscope.features.normalised_images import project_images


class LinearProjection(ImageTransformer):
    """Each image, divided by its length, less a mean, projected onto components.

    Dividing by the Euclidean length (eq. 8 of the paper) makes the features independent of gain;
    an all-black image stays black.
    """

    mean_: Any
    components_: Any

    def _features(self, flat: NDArray[Any]) -> NDArray[np.float64]:
        return project_images(flat, self.mean_, self.components_)


class FixedProjection(LinearProjection):
    """A projection onto functions that do not depend on any image; its mean is 0.

    A subclass checks its parameters and computes `components_` in `_prepare`.
    """

    @abstractmethod
    def _prepare(self) -> None:
        """Compute what depends on the parameters and `image_shape_` alone."""

    def _learn(self, flat: NDArray[Any], targets: Any) -> None:
        self.mean_ = np.zeros(flat.shape[1])
        self._prepare()


class LearnedProjection(LinearProjection):
    """A projection whose `mean_` (n_pixels,) and `components_` are learned from images."""

    _min_images = 2
    _min_pixels = 2
    _is_supervised = True

    def to_arrays(self) -> dict[str, NDArray]:
        """What `transform` needs, as plain arrays."""
        check_is_fitted(self)
        return {
            "image_shape": np.array(self.image_shape_),
            "brightest": np.array([self.grey_scale_, self.brightest_]),
            "mean": np.asarray(self.mean_),
            "components": np.asarray(self.components_),
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, ArrayLike]) -> Self:
        """Features as those that `to_arrays` was called on.

        Raises
        ------
        InvalidInputError
            If an array is missing or the sizes disagree.
        """
        names = ("image_shape", "brightest", "mean", "components")
        if missing := set(names) - set(arrays):
            raise InvalidInputError(f"{cls.__name__} needs the array {min(missing)!r}.")
        shape, brightest, mean, components = (np.asarray(arrays[name]) for name in names)
        n_pixels = mean.size
        if (
            shape.shape != (2,)
            or brightest.shape != (2,)
            or mean.shape != (int(np.prod(shape)),)
            or components.shape != (len(components), n_pixels)
        ):
            raise InvalidInputError(
                f"A mean of {n_pixels} pixels and components of shape {components.shape} do not "
                f"belong to images of {shape.tolist()}: the arrays are not of one family."
            )
        features = cls()
        features.image_shape_ = int(shape[0]), int(shape[1])
        features.n_features_in_ = n_pixels
        features.grey_scale_, features.brightest_ = map(float, brightest)
        features._restore(mean, components)
        return features

    def _restore(self, mean: NDArray, components: NDArray) -> None:
        if "n_components" in self.get_params():
            self.set_params(n_components=len(components))
        self.mean_, self.components_ = mean, components
