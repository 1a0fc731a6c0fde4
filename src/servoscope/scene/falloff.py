"""Light that falls off across the view, as that of a lamp beside the lens does."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import InvalidInputError


@dataclass(frozen=True)
class Falloff:
    """A factor of the light that falls evenly from one side of the view to the other.

    Parameters
    ----------
    bright, dark : float
        The factor at the brightest and at the darkest corner or side.
    seed : int
        Draws the direction.

    Raises
    ------
    InvalidInputError
        If a factor is negative or not finite.

    Examples
    --------
    >>> shaded = Falloff(1.15, 0.7).shade(np.ones((50, 50)))
    >>> shaded.min().round(2), shaded.max().round(2)
    (np.float64(0.7), np.float64(1.15))
    """

    bright: float
    dark: float
    seed: int = 0

    def __post_init__(self) -> None:
        if not all(0 <= factor < np.inf for factor in (self.bright, self.dark)):
            raise InvalidInputError(
                "bright and dark must be finite factors of the light, 0 or more, got "
                f"{self.bright} and {self.dark}."
            )

    def shade(self, grey: NDArray[np.floating]) -> NDArray[np.floating]:
        """The light, or grey levels in proportion to it, (height, width), that is left."""
        angle = np.random.default_rng(self.seed).uniform(0, 2 * np.pi)
        height, width = grey.shape
        y, x = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
        along = np.cos(angle) * x + np.sin(angle) * y
        share = (1 + along / np.abs(along).max()) / 2
        return np.asarray(grey * (self.dark + (self.bright - self.dark) * share), grey.dtype)
