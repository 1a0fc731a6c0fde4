"""Grey levels of 16-bit files as 8-bit ones: how many of the bits are filled."""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import DataSetError, ServoscopeWarning

BIT_DEPTHS = (8, 10, 12, 14, 16)
"""Bits that cameras fill, of which the least that hold the largest grey level are taken."""

_IMAGES_PER_BLOCK = 256


def filled_bits(brightest: int, bit_depth: int | None, where: str) -> int:
    """How many bits the grey levels of 16-bit files fill.

    Parameters
    ----------
    brightest : int
        Largest grey level of all images, before they are resized.
    bit_depth : int, optional
        What the user says.
    where : str
        The images, for errors.

    Raises
    ------
    DataSetError
        If a grey level needs more bits than the user says.

    Warns
    -----
    ServoscopeWarning
        If nobody says, and they are fewer than 16.

    Examples
    --------
    >>> filled_bits(4095, 12, "images")
    12
    """
    if bit_depth is not None:
        if brightest >= 2**bit_depth:
            raise DataSetError(
                f"{where}: the largest grey level is {brightest}, which {bit_depth} bits do not "
                f"hold; give --bit-depth {max(9, int(brightest).bit_length())} or leave it out."
            )
        return bit_depth
    bits = next(bits for bits in BIT_DEPTHS if brightest < 2**bits)
    if bits < 16:
        warnings.warn(
            f"{where}: 16-bit files whose largest grey level is {brightest} were taken to fill "
            f"{bits} bits; if they fill others, say so with --bit-depth.",
            ServoscopeWarning,
            stacklevel=3,
        )
    return bits


def to_eight_bits(levels: NDArray[np.uint8] | NDArray[np.uint16], bits: int) -> NDArray[np.uint8]:
    """The upper eight of the bits that are filled; 8-bit images as they are.

    Examples
    --------
    >>> to_eight_bits(np.array([[4095, 16, 15]], np.uint16), 12)
    array([[255,   1,   0]], dtype=uint8)
    """
    if levels.dtype == np.uint8:
        return np.asarray(levels, dtype=np.uint8)
    images = np.empty(levels.shape, np.uint8)
    for start in range(0, len(levels), _IMAGES_PER_BLOCK):
        block = slice(start, start + _IMAGES_PER_BLOCK)
        images[block] = levels[block] >> (bits - 8)
    return images
