"""The part as the ray caster wants it: a tree of boxes, and tables for shading."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from servoscope.scene.mesh import Mesh
from servoscope.scene.part import CylinderHead

Floats = NDArray[np.float32]

N_SKY_RAYS = 64
"""Rays that find out how much of the sky a point sees."""

TABLE_BOUNCE = 0.5
"""Radiance of the table relative to that of the sky, for the ambient light from below."""

TABLE_MARGIN = 0.12
"""How far around the part the light on the table is mapped, [m]."""

SKY_CELL, LAMP_CELL = 0.004, 0.001
"""Spacing of the map's points at which sky and lamps are looked for, [m]."""

_LIFT = np.float32(2e-4)
"""How far off its surface a ray starts, [m]."""


@dataclass(frozen=True, eq=False)
class Geometry:
    """A part on its table, ready for rays.

    Parameters
    ----------
    mesh : Mesh
    tree : embreex.rtcore_scene.EmbreeScene
    sky : ndarray of shape (n_vertices,)
        Share of the ambient light that reaches each vertex.
    """

    mesh: Mesh
    tree: Any
    sky: Floats


@lru_cache(maxsize=4)
def geometry_of(part: CylinderHead) -> Geometry:
    """The part's geometry; computed once a process."""
    mesh = part.mesh()
    tree = _tree(mesh)
    return Geometry(mesh, tree, _sky(tree, mesh.vertices, mesh.normals))


def map_table_light(geometry: Geometry, lamps: Floats) -> tuple[Floats, Floats]:
    """A map of the light on the table around the part.

    Parameters
    ----------
    geometry : Geometry
    lamps : ndarray of shape (n_lamps, 4)
        Position and strength of each.

    Returns
    -------
    light : ndarray of shape (n_y, n_x, 1 + n_lamps)
        Share of the ambient light, and 1 where each lamp is not shaded, at points of the table
        `LAMP_CELL` apart.
    origin : ndarray of shape (2,)
        The first of those points, [m].
    """
    coarse, fine = (_table_points(geometry.mesh.bounds, cell) for cell in (SKY_CELL, LAMP_CELL))
    up = np.broadcast_to(np.array([0, 0, 1], np.float32), coarse.shape)
    sky = _sky(geometry.tree, coarse.reshape(-1, 3), up.reshape(-1, 3)).reshape(coarse.shape[:2])
    light = np.ones((*fine.shape[:2], 1 + len(lamps)), np.float32)
    light[..., 0] = cv2.resize(sky, light.shape[1::-1], interpolation=cv2.INTER_LINEAR)
    points = fine.reshape(-1, 3)
    for k, lamp in enumerate(lamps, start=1):
        shaded = geometry.tree.run(points, lamp[:3] - points, dists=1.0, query="OCCLUDED") >= 0
        light[..., k] = np.where(shaded.reshape(fine.shape[:2]), 0, 1)
    return light, fine[0, 0, :2].copy()


def _table_points(bounds: Floats, cell: float) -> Floats:
    low, high = bounds[:, :2] + np.array([[-TABLE_MARGIN], [TABLE_MARGIN]])
    x, y = (np.arange(a, b, cell) for a, b in zip(low, high, strict=True))
    points = np.stack([*np.meshgrid(x, y), np.full((len(y), len(x)), bounds[0, 2])], axis=-1)
    return points.astype(np.float32)


def _tree(mesh: Mesh) -> Any:
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    tree = EmbreeScene(robust=True)
    TriangleMesh(tree, mesh.vertices, mesh.triangles)
    return tree


def _sky(tree: Any, points: NDArray[Any], normals: NDArray[Any]) -> Floats:
    """Share of the ambient light that reaches each point, weighted by the cosine law."""
    points = np.asarray(points, np.float32) + _LIFT * np.asarray(normals, np.float32)
    across = np.where(np.abs(normals[:, :1]) < 0.7, [[1.0, 0, 0]], [[0, 1.0, 0]])
    tangent = np.cross(normals, across)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    bitangent = np.cross(normals, tangent)
    sky = np.zeros(len(points), np.float32)
    for x, y, z in _cosine_directions():
        rays = (x * tangent + y * bitangent + z * normals).astype(np.float32)
        seen = tree.run(points, rays, query="OCCLUDED") < 0
        sky += seen * np.where(rays[:, 2] > 0, np.float32(1), np.float32(TABLE_BOUNCE))
    return sky / np.float32(N_SKY_RAYS)


def _cosine_directions() -> NDArray[np.float64]:
    """Directions about z, as dense as the cosine law weighs them."""
    i = np.arange(N_SKY_RAYS) + 0.5
    r, angle = np.sqrt(i / N_SKY_RAYS), i * np.pi * (3 - np.sqrt(5))
    return np.c_[r * np.cos(angle), r * np.sin(angle), np.sqrt(1 - r**2)]
