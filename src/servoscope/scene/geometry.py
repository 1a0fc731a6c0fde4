"""The part as the ray caster wants it: a tree of boxes, and tables for shading."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.scene.mesh import Mesh
from servoscope.scene.part import CylinderHead

Floats = NDArray[np.float32]

N_SKY_RAYS = 64
"""Rays that find out how much of the sky a point sees."""

TABLE_BOUNCE = 0.5
"""Radiance of the table relative to that of the sky, for the ambient light from below."""

TABLE_CELL = 0.004
"""Spacing of the points of the table whose ambient light is computed, [m]."""

TABLE_MARGIN = 0.12
"""How far around the part the table's ambient light is computed, [m]."""

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
    table_sky : ndarray of shape (n_y, n_x)
        The same on a grid of points of the table, `TABLE_CELL` apart, the first of them at
        `table_origin`.
    table_origin : ndarray of shape (2,)
        [m].
    table_z : float
        [m].
    """

    mesh: Mesh
    tree: Any
    sky: Floats
    table_sky: Floats
    table_origin: Floats
    table_z: float


@lru_cache(maxsize=4)
def geometry_of(part: CylinderHead) -> Geometry:
    """The part's geometry; computed once a process."""
    mesh = part.mesh()
    tree = _tree(mesh)
    table_z = float(mesh.bounds[0, 2])
    low, high = mesh.bounds[:, :2] + np.array([[-TABLE_MARGIN], [TABLE_MARGIN]])
    x, y = (np.arange(a, b, TABLE_CELL) for a, b in zip(low, high, strict=True))
    grid = np.stack([*np.meshgrid(x, y), np.full((len(y), len(x)), table_z)], axis=-1)
    up = np.broadcast_to(np.float32([0, 0, 1]), grid.shape)
    table_sky = _sky(tree, grid.reshape(-1, 3), up.reshape(-1, 3)).reshape(len(y), len(x))
    sky = _sky(tree, mesh.vertices, mesh.normals)
    return Geometry(mesh, tree, sky, table_sky, low.astype(np.float32), table_z)


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
