"""The lamps over the cell, and light that falls off across the view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servoscope.errors import InvalidInputError


@dataclass(frozen=True)
class PointLight:
    """A small lamp that shines alike in every direction.

    A white surface at the distance r, its normal at the angle a to the light, scatters the radiance
    ``strength cos(a) / r^2``. The position is in the world, [m], the strength in [m^2].
    """

    position: tuple[float, float, float]
    strength: float

    def __post_init__(self) -> None:
        if len(self.position) != 3 or not np.isfinite(self.position).all():
            raise InvalidInputError(f"position must be 3 finite numbers, got {self.position}.")
        if not 0 <= self.strength < np.inf:
            raise InvalidInputError(
                f"strength must be finite and not negative, got {self.strength}."
            )


@dataclass(frozen=True)
class Lighting:
    """Everything that shines on the cell:

    lamps, which throw shadows, and the radiance that a white surface under open sky scatters from
    the light that comes from all around.
    """

    lamps: tuple[PointLight, ...] = (
        PointLight(position=(0.55, 0.75, 1.15), strength=0.64),
        PointLight(position=(-0.80, -0.45, 1.05), strength=0.50),
    )
    ambient: float = 0.68

    def __post_init__(self) -> None:
        if not 0 <= self.ambient < np.inf:
            raise InvalidInputError(f"ambient must be finite and not negative, got {self.ambient}.")

    def lamp_rows(self) -> NDArray[np.float32]:
        """Position and strength of each lamp, shape (n_lamps, 4)."""
        rows = [(*lamp.position, lamp.strength) for lamp in self.lamps]
        return np.array(rows, dtype=np.float32).reshape(-1, 4)


@dataclass(frozen=True)
class Falloff:
    """A factor of the light that falls evenly from the brightest to the darkest side of the view.

    The seed draws the direction.

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


@njit(inline="always")
def light_at(lamps, ambient, x, y, z):  # type: ignore[no-untyped-def]
    """Radiance that a white plane z would scatter at a point."""
    light = ambient
    for k in range(lamps.shape[0]):
        lx, ly, lz = lamps[k, 0] - x, lamps[k, 1] - y, lamps[k, 2] - z
        distance2 = lx * lx + ly * ly + lz * lz
        light += lamps[k, 3] * max(lz, np.float32(0)) / (distance2 * np.sqrt(distance2))
    return light
