"""The ray caster: what the camera sees from a pose."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.scene import shading
from servoscope.scene.geometry import LAMP_CELL, geometry_of, map_table_light
from servoscope.scene.grain import grain_tile
from servoscope.scene.lens import Lens
from servoscope.scene.materials import material_table
from servoscope.scene.scene import Scene

Floats = NDArray[np.float32]

FEWEST_SAMPLES = 128
"""Samples along each side of an image at the least; smaller images are averaged down."""

CONTRAST = 0.08
"""Pixels that differ from a neighbour by more radiance than this are looked at closely."""

_CENTRE = np.array([[0.5, 0.5]], np.float32)
_DIAGONAL = np.array([[0.25, 0.25], [0.75, 0.75]], np.float32)


def render(
    scene: Scene, T_world_cam: ArrayLike, rng: np.random.Generator | None = None
) -> NDArray[np.uint8]:
    """The image that the camera takes from a pose.

    Parameters
    ----------
    scene : Scene
    T_world_cam : array of shape (4, 4)
        [m].
    rng : Generator, optional
        Draws the noise of the sensor; without it there is none.

    Returns
    -------
    ndarray of shape (image_size, image_size), uint8

    Examples
    --------
    >>> from servoscope.scene.scene import T_WORLD_REF
    >>> render(Scene(image_size=64), T_WORLD_REF).shape
    (64, 64)
    """
    return scene.sensor.read_out(render_radiance(scene, T_world_cam), rng)


def render_radiance(scene: Scene, T_world_cam: ArrayLike) -> Floats:
    """The light that falls on each pixel, 1 being white under full light.

    One ray is cast through the middle of each pixel, and two more through each pixel that
    differs from a neighbour.

    Parameters
    ----------
    scene : Scene
    T_world_cam : array of shape (4, 4)
        [m].

    Returns
    -------
    ndarray of shape (image_size, image_size), float32
    """
    pose = np.asarray(T_world_cam, dtype=np.float32)
    size = scene.image_size
    finer = -(-FEWEST_SAMPLES // size)
    n = size * finer
    radiance = _trace(scene, pose, np.arange(n * n, dtype=np.int32), _CENTRE).reshape(n, n)
    rough = shading.rough_pixels(radiance, np.float32(CONTRAST))
    closer = _trace(scene, pose, rough, _DIAGONAL).reshape(-1, len(_DIAGONAL)).sum(axis=1)
    radiance.ravel()[rough] = (radiance.ravel()[rough] + closer) / (1 + len(_DIAGONAL))
    return radiance.reshape(size, finer, size, finer).mean(axis=(1, 3))


def _trace(scene: Scene, pose: Floats, pixels: NDArray[np.int32], offsets: Floats) -> Floats:
    """Radiance along the rays through each pixel at each offset."""
    n = len(pixels) * len(offsets)
    cell = _cell(scene)
    corners = _pixel_corners(scene.lens, scene.image_size)
    rotation, centre = np.ascontiguousarray(pose[:3, :3]), np.ascontiguousarray(pose[:3, 3])
    rays, origins = np.empty((2, n + 1, 3), np.float32)
    index = np.empty(n, np.int32)
    surface = shading.Surface(*np.empty((3, n, 3), np.float32))
    radiance, lit = np.empty((2, n), np.float32)
    count = shading.aim(corners, pixels, offsets, rotation, centre, cell.bounds, rays, index)
    shading.locate_table(rays[:n], centre, cell.table, cell.ambient, surface, radiance)
    towards_part = index[:count]
    origins[:count] = centre
    hit = cell.tree.run(origins[:count], rays[towards_part], output=True)
    triangle, u, v = hit["primID"], hit["u"], hit["v"]
    shading.locate_part(towards_part, triangle, u, v, cell.part, cell.ambient, surface, radiance)
    for place, lamp in enumerate(cell.lamps, start=1):
        count = shading.aim_at_lamp(
            surface, lamp, place, cell.bounds, cell.table, lit, origins, rays, index
        )
        blocked = cell.tree.run(origins[:count], rays[:count], dists=1.0, query="OCCLUDED")
        lit[index[:count][blocked >= 0]] = 0
        shading.add_light(surface, lamp, centre, lit, radiance)
    return radiance


class _Cell(NamedTuple):
    """All that rays need of a scene."""

    tree: Any
    bounds: Floats
    part: shading.Part
    table: shading.Table
    lamps: Floats
    ambient: np.float32


@lru_cache(maxsize=4)
def _cell(scene: Scene) -> _Cell:
    geometry = geometry_of(scene.part)
    mesh, lamps, looks = geometry.mesh, scene.lighting.lamp_rows(), material_table()
    light, origin = map_table_light(geometry, lamps)
    part = shading.Part(
        mesh.vertices,
        mesh.normals,
        geometry.sky,
        mesh.triangles,
        mesh.materials,
        looks,
        grain_tile(),
    )
    table = shading.Table(mesh.bounds[0, 2], looks[0], light, origin, np.float32(LAMP_CELL))
    return _Cell(geometry.tree, mesh.bounds, part, table, lamps, np.float32(scene.lighting.ambient))


@lru_cache(maxsize=4)
def _pixel_corners(lens: Lens, image_size: int) -> Floats:
    """Where the corners of the samples' pixels lie at unit depth, shape (n + 1, n + 1, 2)."""
    finer = -(-FEWEST_SAMPLES // image_size)
    edges = np.arange(image_size * finer + 1) / finer - 0.5
    grid = np.stack(np.meshgrid(edges, edges), axis=-1)
    return np.ascontiguousarray(lens.rays(grid, image_size)[..., :2], dtype=np.float32)
