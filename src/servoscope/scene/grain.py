"""The grain of surfaces: an unevenness that is tiled over them."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

N_TEXELS = 512
"""Texels a side of the tile; one is a millimetre, so that no part shows a tile twice."""

_SCALES = ((1.3, 1.0), (3.0, 0.8), (11.0, 0.7))
"""Size [mm] and weight of the lumps that a cast surface is made of."""


@lru_cache(maxsize=1)
def grain_tile() -> NDArray[np.float32]:
    """Unevenness of a surface and its slopes along both axes, each of mean 0 and variance 1.

    Returns
    -------
    ndarray of shape (512, 512, 3), float32
        A tile that fits to itself on all sides.
    """
    noise = np.fft.rfft2(np.random.default_rng(512).standard_normal((N_TEXELS, N_TEXELS)))
    fy = 2 * np.pi * np.fft.fftfreq(N_TEXELS)[:, None]
    fx = 2 * np.pi * np.fft.rfftfreq(N_TEXELS)
    spectrum = sum(w * s * np.exp(-0.5 * s**2 * (fx**2 + fy**2)) for s, w in _SCALES)
    spectrum = np.where(fx**2 + fy**2 > 0, spectrum, 0.0)
    channels = [noise * spectrum * factor for factor in (1.0, 1j * fx, 1j * fy)]
    tile = np.stack([np.fft.irfft2(c, s=(N_TEXELS, N_TEXELS)) for c in channels], axis=-1)
    return np.ascontiguousarray(tile / tile.std(axis=(0, 1)), dtype=np.float32)
