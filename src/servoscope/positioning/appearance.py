"""Images made small and smooth, as the levels of the fine stage see them."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from servoscope.errors import InvalidInputError

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class Appearance:
    """How images are smoothed and shrunk.

    Parameters
    ----------
    blur : float
        Standard deviation of the Gaussian that they are smoothed with, [image widths].
    high_pass : float
        Standard deviation of a wider Gaussian that is subtracted, so that slow changes of the
        light vanish, [image widths]; 0 for none.

    Examples
    --------
    >>> Appearance(blur=1 / 16).prepare(np.full((256, 256), 7, np.uint8)).shape
    (24, 24)
    """

    blur: float
    high_pass: float = 0.0

    def __post_init__(self) -> None:
        if not (0 < self.blur < 1 and (self.high_pass == 0 or self.blur < self.high_pass < 1)):
            raise InvalidInputError(
                "blur must lie between 0 and 1 image widths and high_pass above it, or be 0; got "
                f"{self.blur} and {self.high_pass}."
            )

    def shape(self, image_shape: tuple[int, int]) -> tuple[int, int]:
        """Height and width of prepared images: pixels about as wide as the blur, or twice that."""
        height, width = image_shape
        columns = int(min(width, max(24, 1 / self.blur), max(24, width // 2)))
        return max(1, round(columns * height / width)), columns

    def prepare(self, image: NDArray) -> Floats:
        """A smoothed and shrunk image, float32.

        Parameters
        ----------
        image : ndarray of shape (height, width)
        """
        height, width = image.shape
        shape = self.shape((height, width))
        smooth = _smoothed(image, self.blur * width, shape)
        if self.high_pass:
            smooth = smooth - _smoothed(image, self.high_pass * width, shape)
        return smooth


def _smoothed(image: NDArray, sigma: float, shape: tuple[int, int]) -> Floats:
    """Smooth by `sigma` [px] and shrink, after shrinking by what the blur hides anyway."""
    factor = 1
    while sigma >= 3 * factor and image.shape[1] >= 4 * factor * shape[1]:
        factor *= 2
    if factor > 1:
        size = (image.shape[1] // factor, max(image.shape[0] // factor, 1))
        image = cv2.resize(image.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    left = np.sqrt(max(sigma**2 - (factor**2 - 1) / 12, 0.01)) / factor
    smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), left)
    if smooth.shape != shape:
        smooth = cv2.resize(smooth, shape[::-1], interpolation=cv2.INTER_AREA)
    return np.asarray(smooth, dtype=np.float32)
