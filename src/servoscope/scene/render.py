"""The ray caster: what the camera sees from a pose."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.scene import shading
from servoscope.scene.geometry import TABLE_CELL, geometry_of
from servoscope.scene.grain import grain_tile
from servoscope.scene.lens import Lens
from servoscope.scene.materials import material_table
from servoscope.scene.scene import Scene

Floats = NDArray[np.float32]

FEWEST_SAMPLES = 256
"""Samples along each side of an image at the least; smaller images are averaged down."""

CONTRAST = 0.03
"""Pixels that differ from a neighbour by more radiance than this are looked at closely."""

_CENTRE = np.array([[0.5, 0.5]], np.float32)
_ROTATED_GRID = np.array([[3, 1], [7, 3], [1, 5], [5, 7]], np.float32) / 8


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

    One ray is cast through the middle of each pixel, and four more through each pixel that
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
    closer = _trace(scene, pose, rough, _ROTATED_GRID).reshape(-1, len(_ROTATED_GRID))
    radiance.ravel()[rough] = closer.mean(axis=1)
    return radiance.reshape(size, finer, size, finer).mean(axis=(1, 3))


def _trace(scene: Scene, pose: Floats, pixels: NDArray[np.int32], offsets: Floats) -> Floats:
    """Radiance along the rays through each pixel at each offset."""
    n = len(pixels) * len(offsets)
    around, tree = _surroundings(scene)
    corners = _pixel_corners(scene.lens, scene.image_size)
    rotation, centre = np.ascontiguousarray(pose[:3, :3]), np.ascontiguousarray(pose[:3, 3])
    rays, origins = np.empty((2, n + 1, 3), np.float32)
    index = np.empty(n, np.int32)
    surface = shading.Surface(*np.empty((3, n, 3), np.float32))
    radiance = np.empty(n, np.float32)
    count = shading.aim(corners, pixels, offsets, rotation, centre, around.bounds, rays, index)
    shading.locate_table(rays[:n], centre, around, surface, radiance)
    towards_part = index[:count]
    origins[:count] = centre
    hit = tree.run(origins[:count], rays[towards_part], output=True)
    shading.locate_part(
        towards_part, hit["primID"], hit["u"], hit["v"], around, surface, radiance
    )
    shaded = np.empty(n, np.bool_)
    for lamp in scene.lighting.lamp_rows():
        count = shading.aim_at_lamp(surface, lamp, around.bounds, origins, rays, index)
        blocked = tree.run(origins[:count], rays[:count], dists=1.0, query="OCCLUDED")
        shaded[:] = False
        shaded[index[:count]] = blocked >= 0
        shading.add_light(surface, lamp, centre, shaded, radiance)
    return radiance


@lru_cache(maxsize=4)
def _pixel_corners(lens: Lens, image_size: int) -> Floats:
    """Where the corners of the samples' pixels lie at unit depth, shape (n + 1, n + 1, 2)."""
    finer = -(-FEWEST_SAMPLES // image_size)
    edges = np.arange(image_size * finer + 1) / finer - 0.5
    grid = np.stack(np.meshgrid(edges, edges), axis=-1)
    return np.ascontiguousarray(lens.rays(grid, image_size)[..., :2], dtype=np.float32)


@lru_cache(maxsize=4)
def _surroundings(scene: Scene) -> tuple[shading.Surroundings, object]:
    geometry = geometry_of(scene.part)
    mesh = geometry.mesh
    around = shading.Surroundings(
        vertices=mesh.vertices,
        normals=mesh.normals,
        sky=geometry.sky,
        triangles=mesh.triangles,
        materials=mesh.materials,
        looks=material_table(),
        grain=grain_tile(),
        bounds=mesh.bounds,
        table_sky=geometry.table_sky[..., None],
        table_origin=geometry.table_origin,
        table_cell=np.float32(TABLE_CELL),
        ambient=np.float32(scene.lighting.ambient),
    )
    return around, geometry.tree
