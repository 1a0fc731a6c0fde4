"""What a camera sees of a part that is a mesh: rays, cast where they tell something."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from servoscope.scene.aiming import aim, average_in, steep_pixels
from servoscope.scene.geometry import geometry_of
from servoscope.scene.grain import grain_tile
from servoscope.scene.lens import Lens
from servoscope.scene.lights import Lighting
from servoscope.scene.materials import material_table
from servoscope.scene.part import CylinderHead
from servoscope.scene.scene import Scene
from servoscope.scene.shading import Doubts, Hits, Part, add_unblocked, shade
from servoscope.scene.shadows import face_states
from servoscope.scene.table import Table, lay_table

Floats = NDArray[np.float32]

FEWEST_SAMPLES = 128
"""Samples along each side of an image at the least; smaller images are averaged down."""

CONTRAST = 0.1
"""Between pixels that differ by more radiance than this another ray is cast."""

_MIDDLE, _RIGHT, _BELOW = (0.5, 0.5), (1.0, 0.5), (0.5, 1.0)


def traced_radiance(scene: Scene, part: CylinderHead, T_world_cam: Floats) -> Floats:
    """The light that falls on each pixel from a part and its table.

    One ray is cast through the middle of each pixel, and one more between pixels that differ
    from each other.

    Parameters
    ----------
    scene : Scene
        Its part is not looked at.
    part : CylinderHead
    T_world_cam : ndarray of shape (4, 4), float32
        [m].

    Returns
    -------
    ndarray of shape (image_size, image_size), float32
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
