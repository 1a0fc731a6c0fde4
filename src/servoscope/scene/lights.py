"""The lights over the cell."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import InvalidInputError


@dataclass(frozen=True)
class PointLight:
    """A small lamp that shines alike in every direction.

    A white surface at the distance r, its normal at the angle a to the light, scatters the
    radiance ``strength cos(a) / r^2``.

    Parameters
    ----------
    position : tuple of 3 floats
        In the world, [m].
    strength : float
        [m^2].

    Raises
    ------
    InvalidInputError
        If a number is not finite, or the strength is negative.
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
    """Everything that shines on the cell.

    Parameters
    ----------
    lamps : tuple of PointLight
        Each throws shadows.
    ambient : float
        Radiance that a white surface under open sky scatters from the light that comes from
        all around.

    Raises
    ------
    InvalidInputError
        If the ambient light is negative or not finite.
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
