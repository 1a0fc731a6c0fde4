"""What every family of image features is: a scikit-learn transformer of images.

Linear families are projections of brightness-normalised images, fixed or learned.
"""

from __future__ import annotations

import warnings
from abc import ABCMeta, abstractmethod
from collections.abc import Mapping
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, TransformerMixin
from sklearn.utils import Tags
from sklearn.utils.validation import check_is_fitted, validate_data

from servoscope.arrays import check_scale, check_unmasked
from servoscope.errors import InvalidInputError, ServoscopeWarning
from servoscope.features.normalised_images import project_images
from servoscope.poses import DOFS
from servoscope.storage.stacks import Stack, blocks_of

ImageShape = tuple[int, int]


def flatten_images(X: Any, image_shape: ImageShape | None) -> tuple[Any, ImageShape]:
    """Images as rows of pixels, (n_images, height * width), and their height and width.

    Flat arrays, data frames and sparse matrices are handed back as they are; `image_shape` says
    what they are, 1 x n_pixels by default.

    Examples
    --------
    >>> flat, image_shape = flatten_images(np.zeros((5, 3, 4)), None)
    >>> flat.shape, image_shape
    ((5, 12), (3, 4))
    """
    if isinstance(X, Stack):
        height, width = (1, *X.shape[1:])[-2:]
        return X.flat(), image_shape or (height, width)
    check_unmasked(X, "X")
    X = _with_shape(X)
    shape = tuple(X.shape)
    if image_shape is not None:
        image_shape = _checked_image_shape(image_shape)
    if len(shape) == 3:
        if image_shape not in (None, shape[1:]):
            raise InvalidInputError(
                f"Images must be {_size(image_shape)}, as image_shape says, got {_size(shape[1:])}."
            )
        return np.asarray(X).reshape(shape[0], shape[1] * shape[2]), (shape[1], shape[2])
    if len(shape) != 2:
        raise InvalidInputError(
            "Images must have the shape (n_images, height, width) or (n_images, height * width), "
            f"got {shape}. Reshape your data: one image is of shape (1, height, width)."
        )
    if image_shape is not None and shape[1] != image_shape[0] * image_shape[1]:
        raise InvalidInputError(
            f"Flat images of {_size(image_shape)}, as image_shape says, have "
            f"{image_shape[0] * image_shape[1]} pixels, got {shape[1]}."
        )
    return X, image_shape or (1, shape[1])


def check_finite(flat: NDArray[Any]) -> None:
    """Raise `InvalidInputError` if a pixel is NaN or infinite."""
    if not np.issubdtype(flat.dtype, np.floating):
        return
    bad = [i for i, row in enumerate(flat) if not np.isfinite(row).all()]
    if bad:
        raise InvalidInputError(
            f"Pixels must be finite, but image {bad[0]} holds NaN or infinity ({len(bad)} such "
            "images in all); remove or mend them."
        )


def _with_shape(X: Any) -> Any:
    """X itself if it has a shape (arrays, data frames, sparse matrices), else as an array."""
    try:
        return X if hasattr(X, "shape") else np.asarray(X)
    except ValueError:
        raise InvalidInputError(
            "Images must all have the same size, got images of different sizes; resize them."
        ) from None


def _checked_image_shape(image_shape: Any) -> ImageShape:
    try:
        height, width = (int(side) for side in image_shape)
    except (TypeError, ValueError):
        height = width = 0
    if height < 1 or width < 1:
        raise InvalidInputError(
            f"image_shape must be (height, width), two whole numbers from 1, got {image_shape!r}."
        )
    return height, width


def _size(image_shape: Any) -> str:
    return f"{image_shape[0]} x {image_shape[1]} (height x width)"


WHITE = 255.0
CERTAINLY_LEVELS = 16.0
"""The largest grey level, and the one above which pixels are no shares of white."""


class ImageTransformer(TransformerMixin, BaseEstimator, metaclass=ABCMeta):
    """A transformer whose samples are images, of shape (n, height, width) or flat.

    Grey levels go from 0 to 255. Families to which they matter by themselves, not only relative to
    one another, multiply images whose pixels are floats from 0 to 1 in `fit` by 255, there and in
    `transform`, with a warning. None transforms images on another scale than those of `fit`.

    scikit-learn counts the pixels as features, ``n_features_in_ = height * width``; `image_shape_`
    is what `fit` saw. Images of another size and pixels that are not finite are an
    `InvalidInputError`, and so are displacements that are not as many as the images. A subclass has
    a parameter `image_shape`, learns from flat images in `_learn`, computes in `_features`, and
    names its features in `_feature_names`. All of them pass scikit-learn's estimator checks; none
    is left out except that of array API input, which scikit-learn itself skips unless
    SCIPY_ARRAY_API is set.
    """

    image_shape: ImageShape | None
    image_shape_: ImageShape
    _min_images = 1
    _min_pixels = 1
    _levels_matter = False
    _is_supervised = False

    def _check_parameters(self) -> None:
        """Raise InvalidInputError where a parameter is out of range."""

    @abstractmethod
    def _learn(self, flat: NDArray[Any], targets: Any) -> None:
        """Learn from images (n_images, n_pixels) and, if supervised, targets (n_images, k)."""

    @abstractmethod
    def _features(self, flat: NDArray[Any]) -> NDArray[np.float64]:
        """Features (n_images, n_features) of images (n_images, n_pixels)."""

    @abstractmethod
    def _feature_names(self) -> list[str]: ...

    def fit(self, X: Any, y: Any = None) -> Self:
        """Learn what the features are made of; fixed functions take note of the image size alone.

        Parameters
        ----------
        X : array of shape (n_images, height, width) or (n_images, height * width)
            Or a `servoscope.storage.stacks.Stack` of images, which is read block by block.
        y : array of shape (n_images, n_targets) or (n_images,), optional
            Displacement of each image from the reference, [m] and [rad], in `DOFS` order if there
            are six. Families that are not learned from poses ignore it.

        Returns
        -------
        Self
            Itself.
        """
        self._check_parameters()
        if self._is_supervised:
            self._learn(*self._images_and_targets_to_fit(X, y))
        else:
            self._learn(self._images_to_fit(X), None)
        return self

    def transform(self, X: Any) -> NDArray[np.float64]:
        """Features of images, (n_images, n_features), in the order of `get_feature_names_out`."""
        if isinstance(X, Stack):
            return np.concatenate([self.transform(block) for block in blocks_of(X)])
        return self._features(self._images_to_transform(X))

    def get_feature_names_out(self, input_features: Any = None) -> NDArray[np.object_]:
        """Names of the features that `transform` gives, whatever the pixels are called."""
        check_is_fitted(self)
        return np.array(self._feature_names(), dtype=object)

    def _images_to_fit(self, X: Any) -> NDArray[Any]:
        """Flat images after taking note of their shape; a stack is not read for that."""
        if isinstance(X, Stack):
            self._images_to_fit(X[: self._min_images])
            self.brightest_ = max(float(block.max()) for block in blocks_of(X))
            return X.flat()  # type: ignore[return-value]
        flat, image_shape = flatten_images(X, self.image_shape)
        flat = self._validated(flat, reset=True)
        self.image_shape_ = image_shape
        return self._grey_levels_to_fit(flat)

    def _images_and_targets_to_fit(self, X: Any, y: Any) -> tuple[NDArray[Any], NDArray[Any]]:
        """Flat images, and targets of shape (n_images, n_targets)."""
        check_unmasked(y, "y")
        if isinstance(X, Stack):
            if len(np.shape(y)) not in (1, 2) or len(y) != len(X):
                raise InvalidInputError(
                    f"y must be one row for each of {len(X)} images, got the shape {np.shape(y)}."
                )
            targets = np.asarray(y, dtype=np.float64).reshape(len(X), -1)
            few = slice(self._min_images)
            self._images_and_targets_to_fit(X[few], targets[few])
            check_scale(targets, "y")
            return self._images_to_fit(X), targets
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

    def __sklearn_tags__(self) -> Tags:
        tags = super().__sklearn_tags__()
        tags.target_tags.required = self._is_supervised
        tags.target_tags.multi_output = self._is_supervised
        return tags


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


def check_whole_number(name: str, value: Any, least: int) -> None:
    """Raise `InvalidInputError` unless a parameter is a whole number from `least`."""
    if not isinstance(value, int | np.integer) or value < least:
        raise InvalidInputError(f"{name} must be a whole number from {least}, got {value!r}.")


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
        """Features as those that `to_arrays` was called on."""
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
