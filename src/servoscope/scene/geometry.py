"""The part as the ray caster wants it: a tree of boxes, and the sky that it sees."""

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
    return Geometry(mesh, tree, share_of_sky(tree, mesh.vertices, mesh.normals))


def share_of_sky(tree: Any, points: Floats, normals: Floats) -> Floats:
    """Share of the ambient light that reaches each point, weighted by the cosine law.

    Parameters
    ----------
    tree : embreex.rtcore_scene.EmbreeScene
    points, normals : ndarray of shape (n_points, 3), float32
        [m]; unit length.

    Returns
    -------
    ndarray of shape (n_points,), float32
    """
    points = points + _LIFT * normals
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


def _tree(mesh: Mesh) -> Any:
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    tree = EmbreeScene()  # its robust mode costs 15 % and changes one ray in a million
    TriangleMesh(tree, mesh.vertices, mesh.triangles)
    return tree
