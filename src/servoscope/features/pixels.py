"""Images as rows of pixels: their shapes, their brightness, and going through them by blocks."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import InvalidInputError

ImageShape = tuple[int, int]

BLOCK_PIXELS = 4096
_BLOCK_ELEMENTS = 2**23


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
        If X is neither, or is not of the given shape.

    Examples
    --------
    >>> flat, image_shape = flatten_images(np.zeros((5, 3, 4)), None)
    >>> flat.shape, image_shape
    ((5, 12), (3, 4))
    """
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


def brightness_norms(flat: NDArray[Any]) -> NDArray[np.float64]:
    """Euclidean length of each image, exact up to its rounding for uint8 images.

    Examples
    --------
    >>> brightness_norms(np.array([[3, 4], [0, 0]], np.uint8))
    array([5., 0.])
    """
    rows = (row.astype(np.float64, copy=False) for row in flat)
    return np.sqrt([np.vdot(row, row) for row in rows])


def working_dtype(flat: NDArray[Any]) -> type[np.floating[Any]]:
    """float32 for uint8 and float32 images, float64 for others."""
    return np.float32 if flat.dtype in (np.uint8, np.float32) else np.float64


def normalised_blocks(
    flat: NDArray[Any], mean: NDArray[np.float64] | None = None
) -> Iterator[tuple[slice, NDArray[np.float64], NDArray[Any]]]:
    """Brightness-normalised, centred images, a block of pixels at a time.

    No copy of all the images is ever made. Blocks are of `working_dtype`.

    Parameters
    ----------
    flat : ndarray of shape (n_images, n_pixels)
    mean : ndarray of shape (n_pixels,), optional
        What is taken from every normalised image; their own mean by default.

    Yields
    ------
    pixels : slice
        Which pixels the block is made of.
    block_mean : ndarray of shape (n_block,)
        What was taken from each of them.
    block : ndarray of shape (n_images, n_block)

    Notes
    -----
    Each image is divided by its Euclidean length (after eq. 8). An all-black image, which has
    none, stays black.
    """
    norms = brightness_norms(flat)
    if not np.isfinite(norms).all():
        raise InvalidInputError(
            f"Pixels must be small enough for their squares to be summed, but those of image "
            f"{np.flatnonzero(~np.isfinite(norms))[0]} are not; scale the images down."
        )
    dtype = working_dtype(flat)
    gain = np.divide(1.0, norms, out=np.zeros_like(norms), where=norms > 0).astype(dtype)
    n_images, n_pixels = flat.shape
    width = int(np.clip(_BLOCK_ELEMENTS // max(n_images, 1), 64, BLOCK_PIXELS))
    for start in range(0, n_pixels, width):
        pixels = slice(start, start + width)
        block = flat[:, pixels].astype(dtype)
        block *= gain[:, None]
        block_mean = block.mean(axis=0, dtype=np.float64) if mean is None else mean[pixels]
        block -= block_mean.astype(dtype)
        yield pixels, block_mean, block


def project_images(
    flat: NDArray[Any], mean: NDArray[np.float64], components: NDArray[Any]
) -> NDArray[np.float64]:
    """Projections of brightness-normalised, centred images onto the rows of `components`.

    Parameters
    ----------
    flat : ndarray of shape (n_images, n_pixels)
    mean : ndarray of shape (n_pixels,)
        Mean of the normalised images that the components were computed from.
    components : ndarray of shape (n_components, n_pixels)

    Returns
    -------
    ndarray of shape (n_images, n_components)

    Examples
    --------
    >>> project_images(np.array([[3.0, 4.0]]), np.array([0.5, 0.5]), np.eye(2))
    array([[0.1, 0.3]])
    """
    projections = np.zeros((len(flat), len(components)))
    for pixels, _, block in normalised_blocks(flat, mean):
        projections += block @ components[:, pixels].T.astype(block.dtype, copy=False)
    return projections


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
