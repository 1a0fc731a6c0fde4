"""Images of ROS messages, raw and compressed, as grey levels."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from servoscope.errors import DataSetError
from servoscope.formats.images import GreyLevels, decode_bytes
from servoscope.storage.reading import LARGEST_IMAGE

RAW, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"

_GREY = ("mono8", "mono16", "8UC1", "16UC1")
_LUMA = {
    "rgb8": (3, cv2.COLOR_RGB2GRAY),
    "bgr8": (3, cv2.COLOR_BGR2GRAY),
    "8UC3": (3, cv2.COLOR_BGR2GRAY),
    "rgba8": (4, cv2.COLOR_RGBA2GRAY),
    "bgra8": (4, cv2.COLOR_BGRA2GRAY),
    "8UC4": (4, cv2.COLOR_BGRA2GRAY),
    "rgb16": (3, cv2.COLOR_RGB2GRAY),
    "bgr16": (3, cv2.COLOR_BGR2GRAY),
    "rgba16": (4, cv2.COLOR_RGBA2GRAY),
    "bgra16": (4, cv2.COLOR_BGRA2GRAY),
}
_BAYER = {  # OpenCV names a pattern by its second row
    "bayer_rggb": cv2.COLOR_BayerBG2GRAY,
    "bayer_bggr": cv2.COLOR_BayerRG2GRAY,
    "bayer_gbrg": cv2.COLOR_BayerGR2GRAY,
    "bayer_grbg": cv2.COLOR_BayerGB2GRAY,
}
_BRIGHTNESS_FIRST = {
    "yuv422_yuy2": True,
    "yuyv": True,
    "yuv422": False,
    "uyvy": False,
}
ENCODINGS = (*_GREY, *_LUMA, *(f"{b}{n}" for b in _BAYER for n in (8, 16)), *_BRIGHTNESS_FIRST)
"""Encodings of raw images that are read."""


def grey_of_message(message: Any, kind: str, where: str) -> GreyLevels:
    """The image of a message, grey, of 8 or 16 bits.

    Parameters
    ----------
    message : object
        With the fields of a ``sensor_msgs/Image`` or ``CompressedImage``.
    kind : str
        `RAW` or `COMPRESSED`.
    where : str
        For errors.

    Raises
    ------
    DataSetError
        If its encoding is none of `ENCODINGS`, or its sizes do not fit together.
    """
    if kind == RAW:
        return _grey_of_raw(message, where)
    if "compressedDepth" in message.format:
        raise DataSetError(f"{where} is a depth image; name a topic of grey or colour images.")
    return decode_bytes(message.data.tobytes(), where)


def _grey_of_raw(message: Any, where: str) -> GreyLevels:
    luma: Any
    height, width, encoding = int(message.height), int(message.width), str(message.encoding)
    if encoding not in ENCODINGS:
        raise DataSetError(
            f"{where} has the encoding {encoding!r}; read are {', '.join(ENCODINGS)}."
        )
    if encoding in _BRIGHTNESS_FIRST:
        pixels = _pixels(message, height, width, 2, 1, where)
        return np.ascontiguousarray(pixels[..., 0 if _BRIGHTNESS_FIRST[encoding] else 1])
    n_bytes = 2 if "16" in encoding else 1
    if encoding in _LUMA:
        n_channels, conversion = _LUMA[encoding]
        colour = _pixels(message, height, width, n_channels, n_bytes, where)
        luma = cv2.cvtColor(np.ascontiguousarray(colour), conversion)
        return luma
    grey = _pixels(message, height, width, 1, n_bytes, where)[..., 0]
    if encoding in _GREY:
        return grey.copy()
    if min(height, width) < 4:
        raise DataSetError(f"{where} is too small for a Bayer pattern ({width} x {height} px).")
    conversion = _BAYER[encoding.rstrip("0123456789")]
    luma = cv2.cvtColor(np.ascontiguousarray(grey), conversion)
    return luma


def _pixels(
    message: Any, height: int, width: int, n_channels: int, n_bytes: int, where: str
) -> NDArray[Any]:
    """The pixels of shape (height, width, n_channels), without what pads the rows."""
    row, step, size = width * n_channels * n_bytes, int(message.step), message.data.nbytes
    if not (0 < height * width <= LARGEST_IMAGE and row <= step and step * height <= size):
        raise DataSetError(
            f"{where} says {width} x {height} px of {message.encoding} in rows of {step} bytes, "
            f"but holds {size} bytes; leave it out with --skip-bad."
        )
    rows = message.data.view(np.uint8)[: step * height].reshape(height, step)[:, :row]
    kind = np.dtype(np.uint8 if n_bytes == 1 else np.uint16)
    kind = kind.newbyteorder(">" if message.is_bigendian else "<")
    pixels = np.ascontiguousarray(rows).view(kind).reshape(height, width, n_channels)
    return pixels.astype(kind.newbyteorder("="), copy=False)
