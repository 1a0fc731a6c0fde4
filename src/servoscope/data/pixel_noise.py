"""How noisy the pixels of images are: from an image alone, or from several of one view."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

_MASK = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32) / 6
"""Blind to planes and to edges along x and y; keeps the deviation of white noise."""

_BLOCK = 8
_FLATTEST = 0.2

_SELECTED = 0.86
"""What the flattest fifth of the blocks show of noise that is the same everywhere."""


def estimate_pixel_noise(image: NDArray[np.uint8]) -> float:
    """Standard deviation of the noise of one image, [grey].

    Parameters
    ----------
    image : ndarray of shape (height, width), uint8

    Notes
    -----
    After J. Immerkaer, "Fast noise variance estimation", Computer Vision and Image Understanding
    64(2), 1996, but of the flattest fifth of the image's blocks, so that texture counts little.
    Blocks that hold black or white pixels are left out, since noise is cut off there; 0 if
    there are no others. Noise under half a grey level drowns in the rounding of the pixels.

    Examples
    --------
    >>> noise = np.random.default_rng(0).normal(0, 3, (128, 128))
    >>> round(estimate_pixel_noise((100 + noise).round().astype(np.uint8)), 1)
    3.0
    """
    rows, columns = (side // _BLOCK * _BLOCK for side in image.shape)
    filtered = cv2.filter2D(image.astype(np.float32), -1, _MASK)[:rows, :columns]
    variances = _blocks(filtered**2).mean(axis=1)
    grey = _blocks(image[:rows, :columns])
    usable = (grey.min(axis=1) > 0) & (grey.max(axis=1) < 255)
    if not usable.any():
        return 0.0
    return float(np.sqrt(np.quantile(variances[usable], _FLATTEST))) / _SELECTED


def mean_image(images: ArrayLike) -> tuple[NDArray[np.uint8], float | None]:
    """The mean, uint8, of images of one view, and the noise of one of them, [grey].

    That is the standard deviation over the images, in a light that may vary, root mean square over
    the pixels that are never clipped; None of one image, or if all pixels are clipped.

    Examples
    --------
    >>> noise = np.random.default_rng(0).normal(0, 3, (8, 64, 64))
    >>> mean, sigma = mean_image((100 + noise).round().astype(np.uint8))
    >>> round(float(mean.mean())), round(sigma, 1)
    (100, 3.0)
    """
    stack = np.asarray(images, dtype=np.float32)
    mean = np.rint(stack.mean(axis=0)).astype(np.uint8)
    unclipped = ((stack > 0) & (stack < 255)).all(axis=0)
    if len(stack) < 2 or not unclipped.any():
        return mean, None
    grey = stack[:, unclipped]
    grey -= grey.mean(axis=1, keepdims=True)
    return mean, float(np.sqrt(grey.var(axis=0, ddof=1, dtype=float).mean()))


def _blocks(pixels: NDArray) -> NDArray:
    """Blocks of pixels as rows."""
    rows, columns = (side // _BLOCK for side in pixels.shape)
    blocks = pixels.reshape(rows, _BLOCK, columns, _BLOCK).swapaxes(1, 2)
    return blocks.reshape(rows * columns, _BLOCK * _BLOCK)
