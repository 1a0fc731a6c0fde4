"""The white table under the part, and the light on it."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from servoscope.scene.geometry import Geometry, share_of_sky
from servoscope.scene.lights import Lighting
from servoscope.scene.materials import TABLE

Floats = NDArray[np.float32]

MARGIN = 0.12
"""How far around the part the light on the table is mapped, [m]."""

_SKY_CELL, _CELL = 0.004, 0.001
"""Spacing of the map's points, at which sky and lamps are looked for, [m]."""

_FLAT = np.float32(0.02)
"""What a ray must fall towards the table, at unit depth, to be said to meet it."""


class Table(NamedTuple):
    """A plane at the height z, and a map of the radiance that it scatters around the part.

    The map's points are `cell` apart, and the first is at (x, y). Beyond them the table is lit
    by every lamp, and by the ambient light in full. The table scatters light evenly, so that its
    radiance is the same from every side.
    """

    z: np.float32
    albedo: np.float32
    radiance: Floats
    x: np.float32
    y: np.float32
    cell: np.float32
    lamps: Floats
    ambient: np.float32


def lay_table(geometry: Geometry, lighting: Lighting) -> Table:
    """The table that the part stands on and throws its shadows on."""
    bounds, lamps = geometry.mesh.bounds, lighting.lamp_rows()
    coarse, fine = (_points(bounds, cell) for cell in (_SKY_CELL, _CELL))
    up = np.zeros_like(coarse)
    up[..., 2] = 1
    sky = share_of_sky(geometry.tree, coarse.reshape(-1, 3), up.reshape(-1, 3))
    size = fine.shape[1::-1]
    light = lighting.ambient * cv2.resize(sky.reshape(coarse.shape[:2]), size)
    for lamp in lamps:
        ways = (lamp[:3] - fine).reshape(-1, 3)
        shaded = geometry.tree.run(fine.reshape(-1, 3), ways, dists=1.0, query="OCCLUDED") >= 0
        lit = lamp[3] * ways[:, 2] / np.linalg.norm(ways, axis=1) ** 3
        light += np.where(shaded, 0, lit).reshape(light.shape)
    albedo = np.float32(TABLE.albedo)
    return Table(
        z=bounds[0, 2],
        albedo=albedo,
        radiance=albedo * light.astype(np.float32),
        x=fine[0, 0, 0],
        y=fine[0, 0, 1],
        cell=np.float32(_CELL),
        lamps=lamps,
        ambient=np.float32(lighting.ambient),
    )


@njit(inline="always")
def table_radiance(cx, cy, cz, dx, dy, dz, z, albedo, grid, x0, y0, cell, lamps, ambient):  # type: ignore[no-untyped-def]
    """Radiance along the ray from (cx, cy, cz); the further arguments are those of `Table`."""
    if dz > -_FLAT:
        return np.float32(0)
    t = (z - cz) / dz
    x, y = cx + t * dx, cy + t * dy
    u, v = (x - x0) / cell, (y - y0) / cell
    if 0 <= u < grid.shape[1] - 1 and 0 <= v < grid.shape[0] - 1:
        column, row = np.int32(u), np.int32(v)
        u, v = u - np.float32(column), v - np.float32(row)
        top = grid[row, column] + u * (grid[row, column + 1] - grid[row, column])
        low = grid[row + 1, column] + u * (grid[row + 1, column + 1] - grid[row + 1, column])
        return top + v * (low - top)
    light = ambient
    for k in range(lamps.shape[0]):
        lx, ly, lz = lamps[k, 0] - x, lamps[k, 1] - y, lamps[k, 2] - z
        distance2 = lx * lx + ly * ly + lz * lz
        light += lamps[k, 3] * max(lz, np.float32(0)) / (distance2 * np.sqrt(distance2))
    return albedo * light


def _points(bounds: Floats, cell: float) -> Floats:
    low, high = bounds[:, :2] + np.array([[-MARGIN], [MARGIN]])
    x, y = (np.arange(a, b, cell) for a, b in zip(low, high, strict=True))
    points = np.stack([*np.meshgrid(x, y), np.full((len(y), len(x)), bounds[0, 2])], axis=-1)
    return points.astype(np.float32)
