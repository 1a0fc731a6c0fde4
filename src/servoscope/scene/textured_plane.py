"""A flat part that fills the view: a painting, so to say."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft2, rfft2
from scipy.special import ndtr

from servoscope.errors import InvalidInputError

Floats = NDArray[np.float32]

N_TEXELS = 2048
TEXEL = 6e-4
"""Size of a texel, [m]."""

ALBEDO_LIMITS = (0.05, 0.70)
"""Darkest and lightest colour; under the cell's own lights neither end of the greys is met."""

_STREAM = 20011
"""Keeps the random numbers of planes apart from those of other parts."""

_REPAINT = 1
"""Keeps the random numbers of what is painted over apart from those of the first texture."""

_PATCH_SIZES = (0.12, 0.06, 0.03, 0.02)
_DETAILS = ((0.15, 0.8), (0.040, 0.5), (0.010, 0.4), (0.003, 0.5), (0.0012, 0.6))
"""Size of the patches, [m], and size and weight of what is painted over them."""

_BLOTCH = 0.03
"""Size of what is painted over at once, [m]."""

_EDGE = 9e-4
"""Width of the edges between patches, [m]."""


@dataclass(frozen=True)
class TexturedPlane:
    """A flat surface at z = 0 with a random texture of large patches and fine detail.

    It has no border. The texture fits to itself on all sides and repeats after 1.23 m, which is
    more than any view within the range of an acquisition shows.

    Parameters
    ----------
    variant : int
        Another number, from 0, gives another texture.
    repainted : float
        Share of the surface, 0 to 1, on which a texture of other patches and details was painted
        over the first, in blotches of 3 cm.

    Examples
    --------
    >>> TexturedPlane(variant=3)
    TexturedPlane(variant=3, repainted=0.0)
    """

    variant: int = 0
    repainted: float = 0.0

    def __post_init__(self) -> None:
        whole = isinstance(self.variant, int | np.integer) and not isinstance(self.variant, bool)
        if not whole or self.variant < 0:
            raise InvalidInputError(f"variant must be a whole number from 0, got {self.variant!r}.")
        if not 0 <= self.repainted <= 1:
            raise InvalidInputError(f"repainted must be from 0 to 1, got {self.repainted}.")

    def albedo(self) -> Floats:
        """Share of the light that is scattered at each texel, shape (2048, 2048).

        Rows run along the world's y and columns along its x; the middle of the first texel lies
        in the origin.
        """
        picture = _picture(np.random.default_rng([_STREAM, self.variant]))
        if self.repainted > 0:
            rng = np.random.default_rng([_STREAM, self.variant, _REPAINT])
            blotches = _lumps(_BLOTCH, rng)
            repainted = blotches >= np.quantile(blotches, 1 - self.repainted)
            picture = np.where(repainted, _picture(rng), picture)
        low, high = ALBEDO_LIMITS
        return (low + (high - low) * ndtr(picture)).astype(np.float32)


class Pyramid(NamedTuple):
    """A texture, and copies of it that are coarser by a factor of two each, one after another.

    Copy k has ``N_TEXELS >> k`` texels a side and begins at ``starts[k]``.
    """

    texels: Floats
    starts: NDArray[np.int32]


@lru_cache(maxsize=4)
def pyramid_of(part: TexturedPlane) -> Pyramid:
    """The part's texture in every size; computed once a process."""
    copies = [part.albedo()]
    while len(copies[-1]) > 8:
        copies.append(_halved(copies[-1]))
    starts = np.cumsum([0, *(copy.size for copy in copies[:-1])])
    return Pyramid(np.concatenate([copy.ravel() for copy in copies]), starts.astype(np.int32))


def _halved(texels: Floats) -> Floats:
    """A texture that fits to itself, smoothed, without every other row and column."""
    wide = np.pad(texels, 4, mode="wrap")
    return np.asarray(cv2.pyrDown(wide)[2:-2, 2:-2], dtype=np.float32)


def _picture(rng: np.random.Generator) -> Floats:
    """What is painted on the whole plane; of variance 1."""
    picture = _patches(rng) + _details(rng)
    picture /= picture.std()
    return picture


def _patches(rng: np.random.Generator) -> Floats:
    """Patches with winding outlines, each in a grey of its own; of mean 0 and variance 1."""
    sides = [_normed(_lumps(size, rng)) > 0 for size in _PATCH_SIZES]
    label = sum(side.astype(np.uint8) << k for k, side in enumerate(sides))
    grey = rng.permutation(1 << len(sides)).astype(np.float32)[label]
    return _normed(irfft2(rfft2(grey) * _smoothing(_EDGE)))


def _details(rng: np.random.Generator) -> Floats:
    """What is painted over the patches; of mean 0."""
    details = np.zeros((N_TEXELS, N_TEXELS), np.float32)
    for size, weight in _DETAILS:
        details += np.float32(weight) * _normed(_lumps(size, rng))
    return details


def _lumps(size: float, rng: np.random.Generator) -> Floats:
    """Random lumps of a size, [m]."""
    noise = rng.standard_normal((N_TEXELS, N_TEXELS), dtype=np.float32)
    return irfft2(rfft2(noise) * _smoothing(size))


def _normed(picture: Floats) -> Floats:
    return (picture - picture.mean()) / np.float32(picture.std())


def _smoothing(size: float) -> Floats:
    """Spectrum, as of `rfft2`, of a Gaussian whose deviation is half of a size, [m]."""
    sigma = 0.5 * size / TEXEL
    fy = 2 * np.pi * np.fft.fftfreq(N_TEXELS)[:, None]
    fx = 2 * np.pi * np.fft.rfftfreq(N_TEXELS)
    return (np.exp(-0.5 * (sigma * fy) ** 2) * np.exp(-0.5 * (sigma * fx) ** 2)).astype(np.float32)
