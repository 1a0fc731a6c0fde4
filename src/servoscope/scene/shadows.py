"""Which faces of the part each lamp reaches: wholly, not at all, or in part.

Part and lamps stand still while the camera moves, so all this is found out once. Only points on
faces that are lit in part need a ray towards the lamp in every image.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from servoscope.compiled import compiled
from servoscope.scene.geometry import Geometry

Floats = NDArray[np.float32]

DARK, LIT, IN_PART = 0, 1, 2
"""States of a face under a lamp."""

LIFT = np.float32(1e-4)
"""How far off its face a shadow ray starts, [m]."""

_SPACING = np.float32(1.2e-3)
"""Distance of the points of a face at which a lamp is looked for, [m]."""

_INSET = np.float32(0.02)
"""How far the outermost of those points stay off the face's border, relative to its size."""


def face_states(geometry: Geometry, lamps: Floats) -> NDArray[np.uint8]:
    """The state of each face under each lamp, shape (n_triangles, n_lamps).

    Parameters
    ----------
    geometry : Geometry
    lamps : ndarray of shape (n_lamps, 4), float32
        Position and strength of each.
    """
    vertices, triangles = geometry.mesh.vertices, geometry.mesh.triangles
    points, faces = _points_on_faces(vertices, triangles)
    a, b, c = vertices[triangles].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    states = np.empty((len(triangles), len(lamps)), np.uint8)
    n_points = np.bincount(faces, minlength=len(states))
    for k, lamp in enumerate(lamps):
        blocked = geometry.tree.run(points, lamp[:3] - points, dists=1.0, query="OCCLUDED") >= 0
        n_lit = np.bincount(faces[~blocked], minlength=len(states))
        states[:, k] = np.where(n_lit == 0, DARK, np.where(n_lit == n_points, LIT, IN_PART))
        turned_away = ((lamp[:3] - a) * normals).sum(axis=1) <= 0
        states[turned_away, k] = DARK
    return states


def _points_on_faces(
    vertices: Floats, triangles: NDArray[np.int32]
) -> tuple[Floats, NDArray[np.int32]]:
    """Points `_SPACING` apart on every face, lifted off it, and the face of each."""
    n_points = _scatter(vertices, triangles, np.empty((0, 3), np.float32), np.empty(0, np.int32))
    points, faces = np.empty((n_points, 3), np.float32), np.empty(n_points, np.int32)
    _scatter(vertices, triangles, points, faces)
    return points, faces


@compiled(error_model="numpy")
def _scatter(
    vertices: Floats, triangles: NDArray[np.int32], points: Floats, faces: NDArray[np.int32]
) -> int:
    """Write the points as far as there is room; returns how many there are."""
    count = 0
    for face in range(triangles.shape[0]):
        a, b, c = _longest_first(vertices, triangles[face])
        ab, ac = b - a, c - a
        normal = np.array(
            [
                ab[1] * ac[2] - ab[2] * ac[1],
                ab[2] * ac[0] - ab[0] * ac[2],
                ab[0] * ac[1] - ab[1] * ac[0],
            ]
        )
        area, base = np.sqrt((normal**2).sum()), np.sqrt((ab**2).sum())
        n_rows = 2 + int(area / base / _SPACING)
        for row in range(n_rows):
            t = _INSET + (1 - 2 * _INSET) * np.float32(row / (n_rows - 1))
            n_columns = 2 + int((1 - t) * base / _SPACING)
            for column in range(n_columns):
                s = _INSET + (1 - 2 * _INSET) * np.float32(column / (n_columns - 1))
                if count < len(faces):
                    points[count] = a + s * (1 - t) * ab + t * ac + LIFT / area * normal
                    faces[count] = face
                count += 1
    return count


@compiled()
def _longest_first(vertices, triangle):  # type: ignore[no-untyped-def]
    """The corners of a triangle, in its order of turning, with its longest side first."""
    a, b, c = vertices[triangle[0]], vertices[triangle[1]], vertices[triangle[2]]
    ab, bc, ca = ((b - a) ** 2).sum(), ((c - b) ** 2).sum(), ((a - c) ** 2).sum()
    if bc > ab and bc >= ca:
        return b, c, a
    if ca > ab and ca > bc:
        return c, a, b
    return a, b, c
