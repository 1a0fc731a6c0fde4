"""Images made small."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]


def shrink(image: NDArray[Any], size: int) -> Floats:
    """An image whose longer side is `size` pixels, or as it is if that is less, float32.

    Examples
    --------
    >>> shrink(np.full((20, 40), 7, np.uint8), 10).shape
    (5, 10)
    """
    scale = min(1.0, size / max(image.shape))
    height, width = (max(1, round(scale * side)) for side in image.shape)
    whole = image.astype(np.float32)
    return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA))
