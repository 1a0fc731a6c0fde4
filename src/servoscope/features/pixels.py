"""Images as rows of pixels: their shapes, and whether they are sound."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.arrays import check_unmasked
from servoscope.errors import InvalidInputError

ImageShape = tuple[int, int]


def flatten_images(X: Any, image_shape: ImageShape | None) -> tuple[Any, ImageShape]:
    """Images as rows of pixels, and their height and width.

    Parameters
    ----------
    X : array of shape (n_images, height, width) or (n_images, height * width)
        Flat arrays, data frames and sparse matrices are handed back as they are.
    image_shape : (height, width), optional
        What flat images are; 1 x n_pixels by default.

    Returns
    -------
    flat : array of shape (n_images, height * width)
    image_shape : (height, width)

    Raises
    ------
    InvalidInputError
        If X is neither, is not of the given shape, or hides values behind a mask.

    Examples
    --------
    >>> flat, image_shape = flatten_images(np.zeros((5, 3, 4)), None)
    >>> flat.shape, image_shape
    ((5, 12), (3, 4))
    """
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
