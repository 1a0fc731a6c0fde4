"""What is machined into the casting of a cylinder head, and the valves that are put in."""

from __future__ import annotations

import numpy as np
from manifold3d import Manifold
from numpy.typing import NDArray

from servoscope.scene.casting import BOLT_Y, STOCK
from servoscope.scene.solids import bar, box, rod, union

Array = NDArray[np.floating]

_RIDGE, _EAVES = 13.0, 36.0
"""Depth of a pent roof below the deck, and where its slopes reach the deck, [mm]."""

_SLOPE = float(np.degrees(np.arctan2(_RIDGE, _EAVES)))
_VALVE_PLACES = ((-17.5, 17.0, 15.0), (17.5, 17.0, 15.0), (-15.5, -17.0, 12.8), (15.5, -17.0, 12.8))
"""Place in its chamber and radius of each valve, intake first, [mm]."""

_MISSING_VALVES = 0.3


def chamber(x: float, radius: float) -> Manifold:
    """A pent-roof combustion chamber with its ridge along x, [mm]."""
    ends = [x - radius - 2, x + radius + 2]
    ridge, edge = -_RIDGE, _RIDGE / _EAVES * 4
    profile = [(0.0, ridge), (_EAVES + 4, edge), (-_EAVES - 4, edge)]
    roof = Manifold.hull_points(np.array([(e, y, z) for e in ends for y, z in profile]))
    return roof ^ rod(x, 0, (-_RIDGE - 1, STOCK + 1), radius - 3, radius + 1)


def seats(chamber_x: Array) -> Manifold:
    """Valve seats with their throats, and spark-plug bores, [mm]."""
    cutters = []
    for x in chamber_x:
        for dx, dy, r in _VALVE_PLACES:
            seat = rod(0, 0, (-3, 3), r + 1.2, r + 2.4) + rod(0, 0, (-30, 0), r - 2.5)
            cutters.append(_on_slope(seat, x + dx, dy))
        cutters += [rod(x, 0, (-75, 0), 6.5), rod(x, 0, (-_RIDGE - 2, 0), 9.5, 10.5)]
    return union(cutters)


def valves(chamber_x: Array, rng: np.random.Generator) -> Manifold:
    """The valves; some are missing and leave their port open, [mm]."""
    present = rng.random((len(chamber_x), len(_VALVE_PLACES))) > _MISSING_VALVES
    solids = []
    for x, here in zip(chamber_x, present, strict=True):
        for (dx, dy, r), there in zip(_VALVE_PLACES, here, strict=True):
            if there:
                head = (
                    rod(0, 0, (-3, -1), r) + rod(0, 0, (-9, -3), 3.5, r) - rod(0, 0, (-1.7, 0), 4)
                )
                solids.append(_on_slope(head + rod(0, 0, (-34, -3), 3), x + dx, dy))
    return union(solids)


def drillings(chamber_x: Array, bolt_x: Array, rng: np.random.Generator) -> Manifold:
    """Bolt holes, dowels, oil feeds and the threads of what is screwed on, [mm]."""
    holes = [_bolt_hole(x, y) for x in bolt_x for y in (-BOLT_Y, BOLT_Y)]
    for x, y in ((bolt_x[0], -BOLT_Y), (bolt_x[-1], BOLT_Y)):
        holes.append(rod(x, y, (-9, STOCK), 8.5))
    for x, y in zip(chamber_x, rng.uniform(-66, -58, len(chamber_x)), strict=True):
        holes.append(rod(x + 8 * rng.uniform(-1, 1), y + 4, (-40, STOCK), rng.uniform(2.2, 4)))
    for x, y in ((-60, -68), (123, 71), (188, -30), (-160, -66), (-172, 46), (-144, 0)):
        holes.append(rod(x, y, (-45, STOCK), 3.6))
    holes += [rod(x, y, (-97, 0), 3.3) for x in np.arange(-175, 190, 58.0) for y in (-73, 74)]
    holes += [rod(x, 70, (-60, 0), 3.6) for x in chamber_x - 20]
    holes += [rod(171, 61, (-70, 0), 14), rod(-178, 66, (-45, 0), 6), rod(189, -68, (-55, 0), 5)]
    holes += [bar(x, (-90, -65), -28, 3.5) for x in chamber_x + 33]
    return union(holes)


def mill() -> Manifold:
    """The path of the face mill that leaves the deck at z = 0, [mm]."""
    return box((-300, 300), (-200, 200), (0, 50))


def _bolt_hole(x: float, y: float) -> Manifold:
    return rod(x, y, (-97, STOCK), 5.8) + rod(x, y, (-1.5, 0.5), 6.5, 8.5)


def _on_slope(solid: Manifold, x: float, y: float) -> Manifold:
    """A solid made about the origin, set square on the chamber's slope at (x, y)."""
    z = _RIDGE * (abs(y) / _EAVES - 1)
    return solid.rotate([np.sign(y) * _SLOPE, 0, 0]).translate([x, y, z])
