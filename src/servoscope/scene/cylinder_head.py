"""The part: the head of a four-cylinder engine, deck face up, cast and then machined."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from manifold3d import CrossSection, Manifold
from numpy.typing import NDArray

from servoscope.errors import InvalidInputError
from servoscope.scene.mesh import (
    BORED,
    CAST,
    MACHINED,
    SOOT,
    VALVE,
    Material,
    Mesh,
    bar,
    box,
    disc,
    filleted,
    kidney,
    mesh_from_solid,
    plate,
    rectangle,
    rod,
    slot,
    union,
)

Array = NDArray[np.floating]

STOCK = 3.0
"""What the face mill takes off the deck, [mm]."""

BOLT_Y = 53.0
"""Distance of the head bolts from the middle, [mm]."""


def outside(chamber_x: Array, bolt_x: Array, rng: np.random.Generator) -> Manifold:
    """The casting without its cavities, `STOCK` too high, [mm]."""
    return union(
        [
            plate(_deck_outline(bolt_x), (-15, STOCK)),
            box((-182, 184), (-47, 49), (-90, -10)),
            plate(rectangle((-195, -143), (-68, 60), 12), (-96, STOCK)),
            plate(rectangle((-192, 191), (-79, 80), 10), (-96, -74)),
            *_exhaust_side(chamber_x),
            *_intake_side(chamber_x),
            *_bosses(rng),
        ]
    )


def cores(chamber_x: Array, rng: np.random.Generator) -> Manifold:
    """The cavities as cast: chain case, water slots, ports and oil returns, [mm]."""
    turn = rng.uniform(-6, 6, len(chamber_x))
    cavities = [plate(rectangle((-187, -152), (-56, 34), 9), (-97, STOCK + 1))]
    for i, x in enumerate(chamber_x):
        for start, end in ((22, 44), (136, 158), (205, 240), (300, 335)):
            water = kidney(x, 0, 46.5, 7.0, (start + turn[i], end + turn[i]))
            cavities.append(plate(water, (-30, STOCK + 1)))
        cavities.append(plate(slot(x, 53 + turn[i] / 3, 20 + turn[i], 8, turn[i]), (-25, 4)))
        cavities.append(bar(x, (-90, -15), -40, 13.5, 0.9))
        cavities.append(bar(x, (15, 90), -46, 17.0, 0.8))
    between = (chamber_x[:-1] + chamber_x[1:]) / 2
    for x, length in zip(between, rng.uniform(11, 20, len(between)), strict=True):
        cavities.append(plate(slot(x + 17, -58, length, 9, 4), (-97, STOCK + 1)))
    return union(cavities)


def _deck_outline(bolt_x: Array) -> CrossSection:
    outline = rectangle((-186, 190), (-56, 58), 12)
    for i, x in enumerate(bolt_x):
        outline += disc(x, BOLT_Y + 2, 15) + disc(x, -BOLT_Y - 2, 16.5 if i % 2 else 14)
    outline += disc(-60, -68, 9) + disc(123, 71, 8) + disc(188, -30, 7)
    return filleted(outline, 7)


def _exhaust_side(chamber_x: Array) -> list[Manifold]:
    runners = [bar(x, (-83, -30), -40, 20) for x in chamber_x]
    flanges = [box((x - 27, x + 27), (-83, -74), (-62, -18)) for x in chamber_x]
    studs = [bar(x, (-83, -60), -28, 8) for x in chamber_x + 33]
    rib = box((chamber_x[0] - 15, chamber_x[-1] + 15), (-81, -76), (-44, -30))
    return [*runners, *flanges, *studs, rib]


def _intake_side(chamber_x: Array) -> list[Manifold]:
    runners = [
        Manifold.batch_hull([bar(x, (30, 40), -34, 22, 0.8), bar(x + 4, (72, 83), -46, 27, 0.75)])
        for x in chamber_x
    ]
    injectors = [rod(x - 20, 70, (-60, -20), 9, 7) for x in chamber_x]
    bank = box((chamber_x[0] - 34, chamber_x[-1] + 36), (75, 83), (-66, -52))
    return [*runners, *injectors, bank]


def _bosses(rng: np.random.Generator) -> list[Manifold]:
    """Lugs, the thermostat housing and what else is screwed on."""
    rail = [rod(x, y, (-96, -62), 8.5) for x in np.arange(-175, 190, 58.0) for y in (-73, 74)]
    loose = rng.uniform([-150, 62], [170, 72], (3, 2))
    return [
        *rail,
        *(rod(x, y, (-90, -40), 7) for x, y in loose),
        plate(disc(171, 61, 21) + rectangle((150, 192), (40, 60)), (-80, -24)),
        plate(disc(-160, -66, 15), (-80, STOCK)),
        plate(filleted(disc(-178, 66, 13) + rectangle((-190, -160), (40, 58)), 5), (-40, -8)),
        plate(slot(186, -58, 44, 17, 70), (-52, -20)),
        box((60, 66), (45, 80), (-80, -22)),
        box((-64, -59), (-80, -45), (-80, -26)),
    ]


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
        casting = outside(chamber_x, bolt_x, rng).as_original()
        cast_in = cores(chamber_x, rng).as_original()
        roofs = union(chamber(x, self.bore_mm / 2) for x in chamber_x).as_original()
        drilled = drillings(chamber_x, bolt_x, rng).as_original()
        seated = seats(chamber_x).as_original()
        milled = mill().as_original()
        put_in = valves(chamber_x, rng).as_original()
        x, y, z = LENGTH / 2, WIDTH / 2, HEIGHT
        trim = box((-x, x), (-y, y), (-z, z)).as_original()
        head = ((casting - union([cast_in, roofs, seated, drilled, milled])) ^ trim) + put_in
        left_by = [(casting, CAST), (cast_in, CAST), (roofs, SOOT), (drilled, BORED)]
        left_by += [(seated, BORED), (milled, MACHINED), (trim, MACHINED), (put_in, VALVE)]
        materials = {solid.original_id(): material for solid, material in left_by}
        return max(head.decompose(), key=Manifold.volume), materials

    def mesh(self) -> Mesh:
        """The surface of the head, [m]."""
        return mesh_from_solid(*self.solid())
