"""Triangle meshes of parts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from manifold3d import Manifold
from numpy.typing import NDArray

from servoscope.scene.materials import MATERIALS, Material

CREASE_DEG = 32.0
"""Faces that meet at a sharper angle than this keep their own normals."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """A closed triangle mesh with a normal at each vertex and a material for each triangle.

    Parameters
    ----------
    vertices : ndarray of shape (n_vertices, 3)
        [m]. A vertex on a crease stands once for each of its normals.
    normals : ndarray of shape (n_vertices, 3)
        Unit length, pointing out.
    triangles : ndarray of shape (n_triangles, 3), int32
        Indices of vertices, counter-clockwise seen from outside.
    welded : ndarray of shape (n_triangles, 3), int32
        The same triangles with the vertices of a crease joined again: the closed surface.
    materials : ndarray of shape (n_triangles,), uint8
        Indices into `MATERIALS`.
    """

    vertices: NDArray[np.float32]
    normals: NDArray[np.float32]
    triangles: NDArray[np.int32]
    welded: NDArray[np.int32]
    materials: NDArray[np.uint8]

    @property
    def bounds(self) -> NDArray[np.float32]:
        """Lowest and highest corner, of shape (2, 3), [m]."""
        return np.stack([self.vertices.min(axis=0), self.vertices.max(axis=0)])


def mesh_from_solid(solid: Manifold, material_of: dict[int, Material]) -> Mesh:
    """The surface of a solid, smooth but for its creases.

    Parameters
    ----------
    solid : Manifold
        [mm].
    material_of : dict
        Which material each original solid (by its `original_id`) left on the surface.

    Returns
    -------
    Mesh
        [m].
    """
    raw = solid.calculate_normals(0, CREASE_DEG).to_mesh()
    values = np.asarray(raw.vert_properties)
    triangles = np.asarray(raw.tri_verts).astype(np.int32)
    joined = np.arange(len(values), dtype=np.int32)
    joined[np.asarray(raw.merge_from_vert)] = np.asarray(raw.merge_to_vert)
    materials = np.empty(len(triangles), np.uint8)
    ends = np.asarray(raw.run_index) // 3
    for original, start, end in zip(raw.run_original_id, ends[:-1], ends[1:], strict=True):
        materials[start:end] = MATERIALS.index(material_of[int(original)])
    return Mesh(
        vertices=np.ascontiguousarray(values[:, :3] * 1e-3, dtype=np.float32),
        normals=np.ascontiguousarray(values[:, 3:6], dtype=np.float32),
        triangles=triangles,
        welded=joined[triangles],
        materials=materials,
    )
