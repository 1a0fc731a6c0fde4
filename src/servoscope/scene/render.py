"""The ray caster: what the camera sees from a pose."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.scene.aiming import aim, average_in, steep_pixels
from servoscope.scene.geometry import geometry_of
from servoscope.scene.grain import grain_tile
from servoscope.scene.lens import Lens
from servoscope.scene.materials import material_table
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

    One ray is cast through the middle of each pixel, and one more between pixels that differ
    from each other.

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
    middle = _trace(scene, pose, np.arange(n * n, dtype=np.int32), _MIDDLE)
    radiance = middle.copy()
    for down, along, offset in ((0, 1, _RIGHT), (1, 0, _BELOW)):
        pixels = steep_pixels(middle.reshape(n, n), down, along, CONTRAST)
        between = _trace(scene, pose, pixels, offset)
        average_in(middle, between, pixels, down * n + along, radiance)
    return radiance.reshape(size, finer, size, finer).mean(axis=(1, 3))


def _trace(
    scene: Scene, pose: Floats, pixels: NDArray[np.int32], offset: tuple[float, float]
) -> Floats:
    """Radiance along the ray through each pixel at an offset from its left and top, [px]."""
    n = len(pixels)
    cell = _cell(scene)
    corners = _pixel_corners(scene.lens, scene.image_size)
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
def _cell(scene: Scene) -> _Cell:
    geometry = geometry_of(scene.part)
    mesh = geometry.mesh
    part = Part(
        mesh.vertices,
        mesh.normals,
        geometry.sky,
        mesh.triangles,
        mesh.materials,
        face_states(geometry, scene.lighting.lamp_rows()),
        material_table(),
        grain_tile(),
    )
    return _Cell(geometry.tree, mesh.bounds, part, lay_table(geometry, scene.lighting))


@lru_cache(maxsize=4)
def _pixel_corners(lens: Lens, image_size: int) -> Floats:
    """Where the corners of the samples' pixels lie at unit depth, shape (n + 1, n + 1, 2)."""
    finer = -(-FEWEST_SAMPLES // image_size)
    edges = np.arange(image_size * finer + 1) / finer - 0.5
    grid = np.stack(np.meshgrid(edges, edges), axis=-1)
    return np.ascontiguousarray(lens.rays(grid, image_size)[..., :2], dtype=np.float32)
