"""How unlike the reference an image is, whatever its brightness."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from servoscope.errors import InvalidInputError
from servoscope.features.cells import shrink

THUMBNAIL_SIZE = 64
_BLUR = 2.0
_LEAST_CONTRAST = 1.0

Thumbnail = NDArray[np.float32]


def thumbnail(image: NDArray[np.uint8]) -> Thumbnail:
    """The image small and blurred, in which neither noise nor fine texture counts.

    Its longer side is `THUMBNAIL_SIZE` pixels, or that of a smaller image.

    Examples
    --------
    >>> thumbnail(np.zeros((256, 128), np.uint8)).shape
    (64, 32)
    """
    small = cv2.GaussianBlur(shrink(image, THUMBNAIL_SIZE), (0, 0), _BLUR)
    return np.asarray(small, dtype=np.float32)


def image_error(small: Thumbnail, small_reference: Thumbnail) -> float:
    """One minus the zero-mean normalised cross-correlation of two thumbnails, 0 to 2.

    Neither gain nor offset of the image change it. A covered part of the view adds to it, but
    about as much at every pose, so that its rise and fall keep their meaning.

    Examples
    --------
    >>> small = np.arange(12, dtype=np.float32).reshape(3, 4)
    >>> round(image_error(0.5 * small + 7, small), 6), round(image_error(-small, small), 6)
    (0.0, 2.0)
    """
    a, b = (np.ravel(part - part.mean(dtype=float)) for part in (small, small_reference))
    length = float(np.linalg.norm(a) * np.linalg.norm(b))
    return 1.0 - float(a @ b) / length if length > 0 else 1.0


def reference_thumbnail(reference_image: NDArray[np.uint8]) -> Thumbnail:
    """The thumbnail of a reference image.

    Raises
    ------
    InvalidInputError
        If there is nothing to be seen in it.
    """
    small = thumbnail(reference_image)
    if small.std() < _LEAST_CONTRAST:
        raise InvalidInputError(
            f"The reference image must show something, but its grey levels differ by only "
            f"{small.std():.2f}; train on images in which the part is seen."
        )
    return small
