"""What a camera delivers, as a grey image of 8 bits."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import CameraFaultError
from servoscope.formats.images import filled_bits, resized, to_eight_bits


def camera_image(
    levels: NDArray[Any], width: int | None, bit_depth: int | None, where: object
) -> NDArray[np.uint8]:
    """A grey image of 8 or 16 bits, of the wanted width, with the upper eight of its bits.

    Raises
    ------
    CameraFaultError
        If it has 16 bits and nobody says how many of them are filled.
    DataSetError
        If it needs more bits than that, or would be too large.

    Examples
    --------
    >>> camera_image(np.full((2, 4), 4080, np.uint16), 2, 12, "image 1")
    array([[255, 255]], dtype=uint8)
    """
    if levels.dtype != np.uint8 and bit_depth is None:
        raise CameraFaultError(
            f"{where} has 16 bits; say how many of them the camera fills, such as bit_depth=12."
        )
    image, brightest = resized(levels, width, where)
    bits = 8 if levels.dtype == np.uint8 else filled_bits(brightest, bit_depth, str(where))
    return to_eight_bits(image, bits)
