"""The part: the head of a four-cylinder engine, deck face up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from manifold3d import Manifold

from servoscope.errors import InvalidInputError
from servoscope.scene import casting, machining
from servoscope.scene.materials import BORED, CAST, MACHINED, SOOT, VALVE, Material
from servoscope.scene.mesh import Mesh, mesh_from_solid
from servoscope.scene.solids import box, union

LENGTH, WIDTH, HEIGHT = 390.0, 166.0, 96.0
"""Size of the head along world x, y and z, [mm]."""


@dataclass(frozen=True)
class CylinderHead:
    """An aluminium cylinder head of 390 x 166 x 96 mm.

    The milled deck lies in the plane z = 0 and faces up. The head is cast, then machined, and
    each tool leaves its own surface. Four pent-roof chambers stand off centre because the
    chain case takes up the end at -x; intake is at +y, exhaust at -y; no two ends or sides are
    alike.

    Parameters
    ----------
    bore_mm : float
        Diameter of the chambers, 60 to 80, [mm].
    variant : int
        Another number gives another casting: slots, holes and bosses move, other valves are
        missing.

    Examples
    --------
    >>> CylinderHead().mesh().bounds.round(3).tolist()  # doctest: +SKIP
    [[-0.195, -0.083, -0.096], [0.195, 0.083, 0.0]]
    """

    bore_mm: float = 75.0
    variant: int = 0

    def __post_init__(self) -> None:
        if not 60 <= self.bore_mm <= 80:
            raise InvalidInputError(f"bore_mm must lie in 60 to 80 mm, got {self.bore_mm}.")

    def solid(self) -> tuple[Manifold, dict[int, Material]]:
        """The head, [mm], and the material that each original solid left on its surface."""
        rng = np.random.default_rng(self.variant)
        chamber_x = 24.0 + 81.0 * (np.arange(4) - 1.5)
        bolt_x = 24.0 + 81.0 * (np.arange(5) - 2.0)
        cast = casting.outside(chamber_x, bolt_x, rng).as_original()
        cores = casting.cores(chamber_x, rng).as_original()
        roofs = union(machining.chamber(x, self.bore_mm / 2) for x in chamber_x).as_original()
        drills = machining.drillings(chamber_x, bolt_x, rng).as_original()
        seats = machining.seats(chamber_x).as_original()
        mill = machining.mill().as_original()
        valves = machining.valves(chamber_x, rng).as_original()
        x, y, z = LENGTH / 2, WIDTH / 2, HEIGHT
        trim = box((-x, x), (-y, y), (-z, z)).as_original()
        head = ((cast - union([cores, roofs, seats, drills, mill])) ^ trim) + valves
        left_by = [(cast, CAST), (cores, CAST), (roofs, SOOT), (drills, BORED), (seats, BORED)]
        left_by += [(mill, MACHINED), (trim, MACHINED), (valves, VALVE)]
        materials = {solid.original_id(): material for solid, material in left_by}
        return max(head.decompose(), key=Manifold.volume), materials

    def mesh(self) -> Mesh:
        """The surface of the head, [m]."""
        return mesh_from_solid(*self.solid())
