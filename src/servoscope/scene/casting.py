"""The raw casting of a cylinder head: its outside, and the cavities that sand cores leave."""

from __future__ import annotations

import numpy as np
from manifold3d import CrossSection, Manifold
from numpy.typing import NDArray

from servoscope.scene.solids import (
    bar,
    box,
    disc,
    filleted,
    kidney,
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
