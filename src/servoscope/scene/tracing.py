"""What a camera sees of a part that is a mesh: rays, cast where they inform."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servoscope.compiled import compiled
from servoscope.scene.camera import Lens
from servoscope.scene.cylinder_head import CylinderHead
from servoscope.scene.geometry import Table, face_states, geometry_of, lay_table, table_radiance
from servoscope.scene.lighting import Lighting
from servoscope.scene.mesh import grain_tile, material_table
from servoscope.scene.scene import Scene
from servoscope.scene.shading import Doubts, Hits, Part, add_unblocked, shade

Floats = NDArray[np.float32]
Integers = NDArray[np.int32]


@compiled(error_model="numpy")
def aim(
    corners: Floats,
    pixels: Integers,
    offset: tuple[np.float32, np.float32],
    rotation: Floats,
    centre: Floats,
    bounds: Floats,
    table: Table,
    radiance: Floats,
    rays: Floats,
    ray_of: Integers,
) -> int:
    """Turn pixels into rays; the table answers those that pass the part by.

    `corners` (n + 1, n + 1, 2) of the n x n pixels are in camera coordinates, at unit depth;
    `pixels` are row times n plus column, `offset` is where in each rays pass, from its left and
    top, [px]. Rotation and centre are of the camera to the world, `bounds` (2, 3) are a box about
    the part. Written are the radiance of the rays that pass the box by, the directions of the
    others in the world, and which of all the rays those are. Returns how many meet the box.
    """
    z, albedo, grid, x0, y0, cell, lamps, ambient = table
    n, count = np.uint32(corners.shape[0] - 1), 0
    u, v = offset
    r00, r01, r02 = rotation[0, 0], rotation[0, 1], rotation[0, 2]
    r10, r11, r12 = rotation[1, 0], rotation[1, 1], rotation[1, 2]
    r20, r21, r22 = rotation[2, 0], rotation[2, 1], rotation[2, 2]
    cx, cy, cz = centre[0], centre[1], centre[2]
    xl, yl, zl = bounds[0, 0], bounds[0, 1], bounds[0, 2]
    xh, yh, zh = bounds[1, 0], bounds[1, 1], bounds[1, 2]
    for i in range(pixels.size):
        row = np.int32(np.uint32(pixels[i]) // n)
        column = pixels[i] - row * np.int32(n)
        x = _between(corners, row, column, 0, u, v)
        y = _between(corners, row, column, 1, u, v)
        dx = r00 * x + r01 * y + r02
        dy = r10 * x + r11 * y + r12
        dz = r20 * x + r21 * y + r22
        near, far = _clip(np.float32(0), np.float32(np.inf), cx, dx, xl, xh)
        near, far = _clip(near, far, cy, dy, yl, yh)
        near, far = _clip(near, far, cz, dz, zl, zh)
        if near <= far:
            rays[count, 0], rays[count, 1], rays[count, 2] = dx, dy, dz
            ray_of[count] = i
            count += 1
        else:
            radiance[i] = table_radiance(
                cx, cy, cz, dx, dy, dz, z, albedo, grid, x0, y0, cell, lamps, ambient
            )
    return count


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


@njit(inline="always")
def _between(grid, row, column, k, u, v):  # type: ignore[no-untyped-def]
    """Channel k of a grid, at the share u and v of the way to the next column and row."""
    top = grid[row, column, k] + u * (grid[row, column + 1, k] - grid[row, column, k])
    low = grid[row + 1, column, k] + u * (grid[row + 1, column + 1, k] - grid[row + 1, column, k])
    return top + v * (low - top)


@njit(inline="always")
def _clip(near, far, o, d, low, high):  # type: ignore[no-untyped-def]
    """The part of a ray's [near, far] in which it lies between low and high along an axis."""
    d = d if d != 0 else np.float32(1e-30)
    a, b = (low - o) / d, (high - o) / d
    return max(near, min(a, b)), min(far, max(a, b))


FEWEST_SAMPLES = 128
"""Samples along each side of an image at the least; smaller images are averaged down."""

CONTRAST = 0.1
"""Between pixels that differ by more radiance than this another ray is cast."""

_MIDDLE, _RIGHT, _BELOW = (0.5, 0.5), (1.0, 0.5), (0.5, 1.0)


def traced_radiance(scene: Scene, part: CylinderHead, T_world_cam: Floats) -> Floats:
    """The light that falls on each pixel from a part, in place of the scene's, and its table.

    One ray is cast through the middle of each pixel, and one more between pixels that differ.
    """
    size = scene.image_size
    cell = _cell(part, scene.lighting)
    corners = _pixel_corners(scene.lens, size)
    n = len(corners) - 1
    middle = _trace(cell, corners, T_world_cam, np.arange(n * n, dtype=np.int32), _MIDDLE)
    radiance = middle.copy()
    for down, along, offset in ((0, 1, _RIGHT), (1, 0, _BELOW)):
        pixels = steep_pixels(middle.reshape(n, n), down, along, CONTRAST)
        between = _trace(cell, corners, T_world_cam, pixels, offset)
        average_in(middle, between, pixels, down * n + along, radiance)
    return radiance.reshape(size, n // size, size, n // size).mean(axis=(1, 3))


def _trace(
    cell: _Cell,
    corners: Floats,
    pose: Floats,
    pixels: NDArray[np.int32],
    offset: tuple[float, float],
) -> Floats:
    """Radiance along the ray through each pixel at an offset from its left and top, [px]."""
    n = len(pixels)
    rotation, centre = np.ascontiguousarray(pose[:3, :3]), np.ascontiguousarray(pose[:3, 3])
    radiance, rays, ray_of = np.empty(n, np.float32), _empty_rays(n), np.empty(n, np.int32)
    count = aim(
        corners,
        pixels,
        (np.float32(offset[0]), np.float32(offset[1])),
        rotation,
        centre,
        cell.bounds,
        cell.table,
        radiance,
        rays,
        ray_of,
    )
    rays, ray_of = rays[:count], ray_of[:count]
    found = cell.tree.run(np.broadcast_to(centre, rays.shape), rays, output=True)
    hits = Hits(found["primID"], found["u"], found["v"])
    n_doubts = count * len(cell.table.lamps)
    doubts = Doubts(
        _empty_rays(n_doubts),
        _empty_rays(n_doubts),
        np.empty(n_doubts, np.int32),
        np.empty(n_doubts, np.float32),
    )
    count = shade(rays, ray_of, hits, centre, cell.part, cell.table, radiance, doubts)
    origins, ways = doubts.origins[:count], doubts.ways[:count]
    blocker = cell.tree.run(origins, ways, dists=1.0, query="OCCLUDED")
    add_unblocked(blocker, doubts.ray_of, doubts.gain, radiance)
    return radiance


def _empty_rays(n: int) -> Floats:
    return np.empty((n, 3), np.float32)


class _Cell(NamedTuple):
    """All that rays need of a scene."""

    tree: Any
    bounds: Floats
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
    return _Cell(geometry.tree, mesh.bounds, shaded, lay_table(geometry, lighting))


@lru_cache(maxsize=4)
def _pixel_corners(lens: Lens, image_size: int) -> Floats:
    """Where the corners of the samples' pixels lie at unit depth, shape (n + 1, n + 1, 2)."""
    finer = -(-FEWEST_SAMPLES // image_size)
    edges = np.arange(image_size * finer + 1) / finer - 0.5
    grid = np.stack(np.meshgrid(edges, edges), axis=-1)
    return np.ascontiguousarray(lens.rays(grid, image_size)[..., :2], dtype=np.float32)
