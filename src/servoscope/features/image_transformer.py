"""What every family of image features is: a scikit-learn transformer of images."""

from __future__ import annotations

import warnings
from abc import ABCMeta, abstractmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils.validation import check_is_fitted, validate_data

from servoscope.arrays import check_scale, check_unmasked
from servoscope.errors import InvalidInputError, ServoscopeWarning
from servoscope.features.pixels import ImageShape, check_finite, flatten_images
from servoscope.poses import DOFS

WHITE = 255.0
CERTAINLY_LEVELS = 16.0
"""The largest grey level, and the one above which pixels are no shares of white."""


class ImageTransformer(TransformerMixin, BaseEstimator, metaclass=ABCMeta):
    """A transformer whose samples are images, of shape (n, height, width) or flat.

    Grey levels go from 0 to 255. Families to which they matter by themselves, not only relative to
    one another, multiply images whose pixels are floats from 0 to 1 in `fit` by 255, there and in
    `transform`, with a warning. None transforms images on another scale than those of `fit`.

    scikit-learn counts the pixels as features, ``n_features_in_ = height * width``. A subclass
    has a parameter `image_shape`, and names its features in `_feature_names`. All of them pass
    scikit-learn's estimator checks; none is left out except that of array API input, which
    scikit-learn itself skips unless SCIPY_ARRAY_API is set.
    """

    image_shape: ImageShape | None
    image_shape_: ImageShape
    _min_images = 1
    _min_pixels = 1
    _levels_matter = False

    @abstractmethod
    def _feature_names(self) -> list[str]: ...

    def get_feature_names_out(self, input_features: Any = None) -> NDArray[np.object_]:
        """Names of the features that `transform` gives.

        Parameters
        ----------
        input_features : ignored
            The names do not depend on what the pixels are called.

        Returns
        -------
        ndarray of str
        """
        check_is_fitted(self)
        return np.array(self._feature_names(), dtype=object)

    def _images_to_fit(self, X: Any) -> NDArray[Any]:
        """Flat images after taking note of their shape."""
        flat, image_shape = flatten_images(X, self.image_shape)
        flat = self._validated(flat, reset=True)
        self.image_shape_ = image_shape
        return self._grey_levels_to_fit(flat)

    def _images_and_targets_to_fit(self, X: Any, y: Any) -> tuple[NDArray[Any], NDArray[Any]]:
        """Flat images, and targets of shape (n_images, n_targets)."""
        check_unmasked(y, "y")
        flat, image_shape = flatten_images(X, self.image_shape)
        flat, y = self._validated(flat, y, reset=True, multi_output=True, y_numeric=True)
        self.image_shape_ = image_shape
        targets = y.reshape(len(y), -1).astype(np.float64)
        check_scale(targets, "y")
        return self._grey_levels_to_fit(flat), targets

    def _images_to_transform(self, X: Any) -> NDArray[Any]:
        """Flat images, if they are of the shape seen in `fit`."""
        check_is_fitted(self)
        flat, image_shape = flatten_images(X, None)
        height, width = self.image_shape_
        is_flat = image_shape == (1, flat.shape[1])
        if flat.shape[1] != height * width or not (is_flat or image_shape == self.image_shape_):
            came = f"{flat.shape[1]} pixels" if is_flat else "{} x {}".format(*image_shape)
            raise InvalidInputError(
                f"X has {flat.shape[1]} features, but {type(self).__name__} is expecting "
                f"{height * width} features as input: the images are of {came}, those of fit "
                f"were of {height} x {width} (height x width); resize them."
            )
        return self._grey_levels_to_transform(self._validated(flat, reset=False))

    def _grey_levels_to_fit(self, flat: NDArray[Any]) -> NDArray[Any]:
        """Grey levels from 0 to 255, after taking note of how they were given."""
        self.grey_scale_, self.brightest_ = 1.0, float(flat.max())
        if not self._levels_matter or not _are_shares(flat):
            return flat
        self.grey_scale_ = WHITE
        warnings.warn(
            "The images are floats from 0 to 1; they are multiplied by 255, as are those that "
            f"{type(self).__name__} transforms. Give grey levels from 0 to 255 where they are not.",
            ServoscopeWarning,
            stacklevel=4,
        )
        return flat * self.grey_scale_

    def _grey_levels_to_transform(self, flat: NDArray[Any]) -> NDArray[Any]:
        """Grey levels on the scale of those seen in `fit`."""
        scale, brightest = getattr(self, "grey_scale_", 1.0), getattr(self, "brightest_", 0.0)
        if scale == 1.0 and brightest > CERTAINLY_LEVELS and _are_shares(flat):
            raise InvalidInputError(
                f"The images are floats from 0 to 1, but those of fit had grey levels up to "
                f"{brightest:g}; multiply them by 255, or, if the images are black, leave them out."
            )
        if 0 < brightest <= 1 and flat.max() > CERTAINLY_LEVELS:
            raise InvalidInputError(
                f"The images have grey levels up to {flat.max():g}, but those of fit up to "
                f"{brightest:g}; divide them by 255."
            )
        return flat if scale == 1.0 else flat * scale

    def _validated(self, *arrays: Any, reset: bool, **checks: Any) -> Any:
        try:
            valid = validate_data(
                self,
                *arrays,
                reset=reset,
                ensure_all_finite=False,
                ensure_min_samples=self._min_images if reset else 1,
                ensure_min_features=self._min_pixels,
                **checks,
            )
        except ValueError as error:
            raise InvalidInputError(str(error)) from error
        check_finite(valid[0] if isinstance(valid, tuple) else valid)
        return valid


def _are_shares(flat: NDArray[Any]) -> bool:
    """Whether pixels are shares of white, from 0 to 1, rather than grey levels."""
    if not np.issubdtype(flat.dtype, np.floating):
        return False
    return bool(flat.min() >= 0 and 0 < flat.max() <= 1)


def target_names(n_targets: int) -> list[str]:
    """The degrees of freedom if there are six targets, else their numbers.

    Examples
    --------
    >>> target_names(6)[0], target_names(2)
    ('tx', ['0', '1'])
    """
    return list(DOFS) if n_targets == len(DOFS) else [str(i) for i in range(n_targets)]
