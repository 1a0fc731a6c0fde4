"""What a camera sees of a part that is a mesh: rays, cast where they inform."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from servoscope.compiled import compiled
from servoscope.scene.cylinder_head import CylinderHead
from servoscope.scene.geometry import Table, blockers, face_states, geometry_of, lay_table
from servoscope.scene.lighting import Lighting
from servoscope.scene.mesh import grain_tile, material_table
from servoscope.scene.scene import Scene
from servoscope.scene.shading import Part, ShadowRays, add_unblocked, shade
from servoscope.scene.visibility import Outlines, RayGrid, first_hits, outlines, ray_grid

Floats = NDArray[np.float32]
Integers = NDArray[np.int32]


@compiled()
def steep_pixels(radiance: Floats, down: int, along: int, contrast: float) -> Integers:
    """Indices of pixels that differ by over `contrast` from the one so far down and along."""
    n_rows, n_columns = radiance.shape
    steep = np.empty(radiance.size, np.int32)
    count = 0
    for row in range(n_rows - down):
        for column in range(n_columns - along):
            if abs(radiance[row + down, column + along] - radiance[row, column]) > contrast:
                steep[count] = row * n_columns + column
                count += 1
    return steep[:count]


@compiled()
def average_in(
    middle: Floats, between: Floats, pixels: Integers, step: int, radiance: Floats
) -> None:
    """Let what is seen between pixels and their neighbours, `step` on, count in both.

    Notes
    -----
    The mean over a pixel is taken as 1/3 of its middle and 1/6 of the middle of each side, which
    is exact for polynomials of third degree. Where a neighbour is alike, its side counts as the
    middle does.
    """
    share = np.float32(1 / 6)
    for j in range(pixels.size):
        here, there = pixels[j], pixels[j] + step
        radiance[here] += share * (between[j] - middle[here])
        radiance[there] += share * (between[j] - middle[there])


FEWEST_SAMPLES = 128
"""Samples along each side of an image at the least; smaller images are averaged down."""

CONTRAST = 0.1
"""Between pixels that differ by more radiance than this another ray is cast."""


def traced_radiance(scene: Scene, part: CylinderHead, T_world_cam: Floats) -> Floats:
    """The light that falls on each pixel from a part, in place of the scene's, and its table.

    One ray is cast through the middle of each pixel, and one more between pixels that differ.
    """
    size, lens = scene.image_size, scene.lens
    n = size * -(-FEWEST_SAMPLES // size)
    cell = _cell(part, scene.lighting)
    seen = outlines(cell.part.vertices, cell.part.triangles, T_world_cam, lens, n)
    everywhere = np.arange(n * n, dtype=np.int32)
    middle = _trace(cell, seen, ray_grid(lens, n, 0.0, 0.0), T_world_cam, everywhere)
    radiance = middle.copy()
    for down, along in ((0, 1), (1, 0)):
        pixels = steep_pixels(middle.reshape(n, n), down, along, CONTRAST)
        grid = ray_grid(lens, n, along / 2, down / 2)
        between = _trace(cell, seen, grid, T_world_cam, pixels)
        average_in(middle, between, pixels, down * n + along, radiance)
    return radiance.reshape(size, n // size, size, n // size).mean(axis=(1, 3))


def _trace(cell: _Cell, seen: Outlines, grid: RayGrid, pose: Floats, pixels: Integers) -> Floats:
    """Radiance along the rays of some pixels."""
    rotation, centre = np.ascontiguousarray(pose[:3, :3]), np.ascontiguousarray(pose[:3, 3])
    hits = first_hits(seen, grid, pixels)
    radiance = np.empty(len(pixels), np.float32)
    n_most = np.count_nonzero(hits.face >= 0) * len(cell.table.lamps)
    rays = ShadowRays(
        np.empty((n_most, 3), np.float32),
        np.empty((n_most, 3), np.float32),
        np.empty(n_most, np.int32),
        np.empty(n_most, np.float32),
    )
    count = shade(hits, pixels, grid, rotation, centre, cell.part, cell.table, radiance, rays)
    blocker = blockers(cell.tree, rays.origins[:count], rays.directions[:count])
    add_unblocked(blocker, rays.ray_of, rays.gain, radiance)
    return radiance


class _Cell(NamedTuple):
    """All that rays need of a scene."""

    tree: Any
    part: Part
    table: Table


@lru_cache(maxsize=4)
def _cell(part: CylinderHead, lighting: Lighting) -> _Cell:
    geometry = geometry_of(part)
    mesh = geometry.mesh
    shaded = Part(
        mesh.vertices,
        mesh.normals,
        geometry.sky,
        mesh.triangles,
        mesh.materials,
        face_states(geometry, lighting.lamp_rows()),
        material_table(),
        grain_tile(),
    )
    return _Cell(geometry.tree, shaded, lay_table(geometry, lighting))
