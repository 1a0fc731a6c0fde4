"""What every family of image features is: a scikit-learn transformer of images."""

from __future__ import annotations

from abc import ABCMeta, abstractmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils.validation import check_is_fitted, validate_data

from servoscope.arrays import check_scale, check_unmasked
from servoscope.errors import InvalidInputError
from servoscope.features.pixels import ImageShape, check_finite, flatten_images
from servoscope.poses import DOFS


class ImageTransformer(TransformerMixin, BaseEstimator, metaclass=ABCMeta):
    """A transformer whose samples are images, of shape (n, height, width) or flat.

    scikit-learn counts the pixels as features, ``n_features_in_ = height * width``. A subclass
    has a parameter `image_shape`, and names its features in `_feature_names`. All of them pass
    scikit-learn's estimator checks; none is left out except that of array API input, which
    scikit-learn itself skips unless SCIPY_ARRAY_API is set.
    """

    image_shape: ImageShape | None
    image_shape_: ImageShape
    _min_images = 1
    _min_pixels = 1

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
        return flat

    def _images_and_targets_to_fit(self, X: Any, y: Any) -> tuple[NDArray[Any], NDArray[Any]]:
        """Flat images, and targets of shape (n_images, n_targets)."""
        check_unmasked(y, "y")
        flat, image_shape = flatten_images(X, self.image_shape)
        flat, y = self._validated(flat, y, reset=True, multi_output=True, y_numeric=True)
        self.image_shape_ = image_shape
        targets = y.reshape(len(y), -1).astype(np.float64)
        check_scale(targets, "y")
        return flat, targets

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
        return self._validated(flat, reset=False)

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


def target_names(n_targets: int) -> list[str]:
    """The degrees of freedom if there are six targets, else their numbers.

    Examples
    --------
    >>> target_names(6)[0], target_names(2)
    ('tx', ['0', '1'])
    """
    return list(DOFS) if n_targets == len(DOFS) else [str(i) for i in range(n_targets)]
