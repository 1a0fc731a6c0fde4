"""The few solids that a head is built from. Lengths in mm, angles in degrees, z up."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from manifold3d import CrossSection, JoinType, Manifold, OpType

_SAGITTA = 0.05
"""How far a facet may stand off the round surface that it stands for, [mm]."""

Range = tuple[float, float]


def union(solids: Iterable[Manifold]) -> Manifold:
    """All the solids in one."""
    return Manifold.batch_boolean(list(solids), OpType.Add)


def box(x: Range, y: Range, z: Range) -> Manifold:
    """A block between the given coordinates."""
    low, high = np.array([x, y, z]).T
    return Manifold.cube(high - low).translate(low)


def rod(x: float, y: float, z: Range, radius: float, top_radius: float | None = None) -> Manifold:
    """A cylinder, or cone, standing upright."""
    top = radius if top_radius is None else top_radius
    return Manifold.cylinder(z[1] - z[0], radius, top, _sides(max(radius, top))).translate(
        [x, y, z[0]]
    )


def bar(x: float, y: Range, z: float, radius: float, squash: float = 1.0) -> Manifold:
    """A cylinder along y, its height scaled by `squash`."""
    lying = Manifold.cylinder(y[1] - y[0], radius, radius, _sides(radius)).rotate([-90, 0, 0])
    return lying.scale([1, 1, squash]).translate([x, y[0], z])


def plate(outline: CrossSection, z: Range) -> Manifold:
    """An outline in the xy plane, extruded."""
    return outline.extrude(z[1] - z[0]).translate([0, 0, z[0]])


def rectangle(x: Range, y: Range, corner: float = 0.0) -> CrossSection:
    """A rectangle with rounded corners."""
    sharp = CrossSection.square([x[1] - x[0] - 2 * corner, y[1] - y[0] - 2 * corner])
    return _grown(sharp, corner).translate([x[0] + corner, y[0] + corner])


def disc(x: float, y: float, radius: float) -> CrossSection:
    """A full circle."""
    return CrossSection.circle(radius, _sides(radius)).translate([x, y])


def slot(x: float, y: float, length: float, width: float, angle: float) -> CrossSection:
    """A slot with round ends, its long side at `angle` from x."""
    core = CrossSection.square([length - width, 1e-2], True)
    return _grown(core, width / 2).rotate(angle).translate([x, y])


def kidney(x: float, y: float, radius: float, width: float, angles: Range) -> CrossSection:
    """A curved slot along an arc about (x, y)."""
    a = np.radians(np.linspace(*angles, 13))
    inner, outer = radius - 5e-3, radius + 5e-3
    arc = np.concatenate(
        [np.c_[np.cos(a), np.sin(a)] * outer, np.c_[np.cos(a), np.sin(a)][::-1] * inner]
    )
    return _grown(CrossSection([arc]), width / 2).translate([x, y])


def filleted(outline: CrossSection, radius: float) -> CrossSection:
    """The outline with its inner corners filled to a radius."""
    return _grown(_grown(outline, radius), -radius)


def _grown(outline: CrossSection, by: float) -> CrossSection:
    return outline.offset(by, JoinType.Round, 2.0, _sides(abs(by))) if by else outline


def _sides(radius: float) -> int:
    """Sides of a full circle."""
    return max(16, 4 * int(np.ceil(np.pi / np.arccos(1 - _SAGITTA / radius) / 4)))
