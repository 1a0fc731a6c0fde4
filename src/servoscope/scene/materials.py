"""What the surfaces of the cell look like."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Material:
    """How a surface answers light.

    Parameters
    ----------
    albedo : float
        Share of the light that is scattered evenly (Lambert), 0 to 1.
    specular : float
        Strength of the highlight (Blinn-Phong), relative to white.
    shininess : float
        Exponent of the highlight; the larger, the narrower.
    mottle : float
        Standard deviation of the albedo over the surface, relative to it.
    roughness : float
        Standard deviation of the slope of the surface, [rad].
    milled : bool
        Whether mottle follows the arcs of a face mill instead of lying at random.
    """

    albedo: float
    specular: float = 0.0
    shininess: float = 1.0
    mottle: float = 0.0
    roughness: float = 0.0
    milled: bool = False


TABLE = Material(albedo=0.90)
CAST = Material(albedo=0.30, specular=0.03, shininess=8.0, mottle=0.10, roughness=0.10)
MACHINED = Material(
    albedo=0.41, specular=0.06, shininess=12.0, mottle=0.025, roughness=0.004, milled=True
)
BORED = Material(albedo=0.22, specular=0.05, shininess=20.0, mottle=0.02)
VALVE = Material(albedo=0.32, specular=0.12, shininess=30.0, mottle=0.05, roughness=0.01)
SOOT = Material(albedo=0.26, specular=0.02, shininess=6.0, mottle=0.14, roughness=0.06)

MATERIALS = (TABLE, CAST, MACHINED, BORED, VALVE, SOOT)
"""Every material; a mesh names them by their place here."""


def material_table() -> NDArray[np.float32]:
    """`MATERIALS` as rows of numbers, in the order of `Material`'s fields."""
    rows = [(m.albedo, m.specular, m.shininess, m.mottle, m.roughness, m.milled) for m in MATERIALS]
    return np.array(rows, dtype=np.float32)
