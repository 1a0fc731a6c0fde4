"""What features are taken of: images made small, locally normalised, or told by their slopes."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from servoscope.features.cells import divided, normalised_slopes, orientation_cells, shrink
from servoscope.features.moments import PAPER_SLICES, compute_descriptors, compute_raw_moments

Image = NDArray[np.uint8]
Vector = NDArray[np.float32]

GREY_SIZE, LOCAL_SIZE, GRADIENT_SIZE, ORIENTATION_SIZE = 64, 32, 24, 64
"""Pixels along the longer side of what each preparation looks at."""

CELLS = 8
_BLUR, _NEIGHBOURHOOD = 0.8, 4.0


def moments(image: Image) -> Vector:
    """The paper's 24 geometric moments of the image at full size."""
    raw = compute_raw_moments(image[None], PAPER_SLICES)
    return compute_descriptors(raw, (image.shape[0], image.shape[1])).ravel().astype(np.float32)


def grey(image: Image) -> Vector:
    """The image itself made small, of unit length (after eq. 8 of the paper)."""
    return _unit(shrink(image, GREY_SIZE))


def local(image: Image) -> Vector:
    """Contrast with the surroundings in units of the surroundings' own, of unit length.

    Where they have much less contrast than the image has elsewhere, it fades to 0. Neither gain
    nor offset change it, and a light that falls off slowly hardly does.

    Examples
    --------
    >>> image = np.random.default_rng(0).integers(0, 100, (64, 64), dtype=np.uint8)
    >>> np.allclose(local(2 * image + 9), local(image), atol=1e-5)
    True
    """
    small = _blurred(shrink(image, LOCAL_SIZE), _BLUR)
    contrast = small - _blurred(small, _NEIGHBOURHOOD)
    scale = np.sqrt(_blurred(contrast * contrast, _NEIGHBOURHOOD))
    return _unit(divided(contrast, scale, 0.5 * np.median(scale)))


def gradient(image: Image) -> Vector:
    """Slopes along x and y divided by their magnitude and twice its mean, of unit length.

    Neither gain nor offset change them, and something that covers the view or shines changes
    only those beside it.

    Examples
    --------
    >>> image = np.random.default_rng(0).integers(0, 100, (64, 64), dtype=np.uint8)
    >>> np.allclose(gradient(2 * image + 9), gradient(image), atol=1e-5)
    True
    """
    return _unit(normalised_slopes(image, GRADIENT_SIZE))


def orientation(image: Image) -> Vector:
    """How much slope there is in each of 8 directions about each of 8 x 8 places.

    The slopes are those of `gradient`, at twice the size or more; see `orientation_cells`. It
    changes more smoothly with the pose than slopes at one place do.

    Examples
    --------
    >>> image = np.random.default_rng(0).integers(0, 100, (64, 64), dtype=np.uint8)
    >>> orientation(image).shape
    (512,)
    """
    return orientation_cells(image, ORIENTATION_SIZE, CELLS).ravel()


PREPARATIONS: dict[str, Callable[[Image], Vector]] = {
    "moments": moments,
    "grey": grey,
    "local": local,
    "gradient": gradient,
    "orientation": orientation,
}
"""What can be made of an image, by name."""


def _blurred(values: NDArray[np.float32], sigma: float) -> NDArray[np.float32]:
    return np.asarray(cv2.GaussianBlur(values, (0, 0), sigma))


def _unit(values: NDArray[np.float32]) -> Vector:
    flat = values.ravel()
    length = np.sqrt(flat @ flat)
    return flat / length if length > 0 else flat
