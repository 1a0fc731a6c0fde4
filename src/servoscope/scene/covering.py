"""Something that hangs before the lens and hides a part of every image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import InvalidInputError

_ASPECTS = (0.6, 1.7)
"""Least and largest width over height."""

_RADIANCES = (0.1, 0.9)


@dataclass(frozen=True)
class Covering:
    """An opaque rectangle of one grey, fixed in the image.

    Parameters
    ----------
    share : float
        Of the image that it hides, 0 to 1.
    seed : int
        Draws its place, its form and its grey.

    Raises
    ------
    InvalidInputError
        If the share is not from 0 to 1, or the seed not a whole number from 0.

    Examples
    --------
    >>> Covering(share=0.25, seed=1).cover(np.full((8, 8), -1.0)).clip(0).astype(bool).sum()
    np.int64(16)
    """

    share: float
    seed: int = 0

    def __post_init__(self) -> None:
        if not 0 <= self.share <= 1:
            raise InvalidInputError(f"share must be from 0 to 1, got {self.share}.")
        if not isinstance(self.seed, int | np.integer) or self.seed < 0:
            raise InvalidInputError(f"seed must be a whole number from 0, got {self.seed!r}.")

    def cover(self, radiance: NDArray[np.floating]) -> NDArray[np.floating]:
        """The light that is left, (size, size); less than half a row is missing of the share."""
        size = len(radiance)
        rng = np.random.default_rng(self.seed)
        aspect = np.exp(rng.uniform(*np.log(_ASPECTS)))
        width = round(size * float(np.clip(np.sqrt(self.share * aspect), self.share, 1)))
        height = min(size, round(self.share * size**2 / max(width, 1)))
        u, v = rng.random(2)
        left, top = int(u * (size - width + 1)), int(v * (size - height + 1))
        covered = radiance.copy()
        covered[top : top + height, left : left + width] = rng.uniform(*_RADIANCES)
        return covered
