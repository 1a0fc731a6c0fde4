"""The part on its table as the ray caster wants it, and what of it lamps and sky reach."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from servoscope.compiled import compiled
from servoscope.errors import ServoscopeError
from servoscope.scene.cylinder_head import CylinderHead
from servoscope.scene.lighting import Lighting, light_at
from servoscope.scene.mesh import TABLE, Mesh

Floats = NDArray[np.float32]

N_SKY_RAYS = 64
"""Rays that find out how much of the sky a point sees."""

TABLE_BOUNCE = 0.5
"""Radiance of the table relative to that of the sky, for the ambient light from below."""

_LIFT = np.float32(2e-4)
"""How far off its surface a ray starts, [m]."""


@dataclass(frozen=True, eq=False)
class Geometry:
    """A part on its table, ready for rays, and the share of the ambient light at each vertex."""

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
    """Share of the ambient light that reaches each point, [m], weighted by the cosine law."""
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
    try:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene
    except ImportError as error:
        raise ServoscopeError(
            f"The simulated cylinder head needs embreex, which cannot be imported ({error}). It "
            "has no wheels for ARM Linux; take --part textured_plane, or another machine."
        ) from error

    tree = EmbreeScene()  # its robust mode costs 15 % and changes one ray in a million
    TriangleMesh(tree, mesh.vertices, mesh.triangles)
    return tree


def blockers(tree: Any, origins: Floats, ways: Floats) -> NDArray[np.int32]:
    """What lies between each origin and the end of its way, both [m]; -1 for nothing."""
    found: NDArray[np.int32] = tree.run(origins, ways, dists=1.0, query="OCCLUDED")
    return found


DARK, LIT, IN_PART = 0, 1, 2
"""States of a face under a lamp."""

LIFT = np.float32(1e-4)
"""How far off its face a shadow ray starts, [m]."""

_SPACING = np.float32(1.2e-3)
"""Distance of the points of a face at which a lamp is looked for, [m]."""

_INSET = np.float32(0.02)
"""How far the outermost of those points stay off the face's border, relative to its size."""


def face_states(geometry: Geometry, lamps: Floats) -> NDArray[np.uint8]:
    """The state of each face under each lamp, (n_triangles, n_lamps); lamps are positions and
    strengths.
    """
    vertices, triangles = geometry.mesh.vertices, geometry.mesh.triangles
    points, faces = _points_on_faces(vertices, triangles)
    a, b, c = vertices[triangles].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    states = np.empty((len(triangles), len(lamps)), np.uint8)
    n_points = np.bincount(faces, minlength=len(states))
    for k, lamp in enumerate(lamps):
        turned_to = ((lamp[:3] - a) * normals).sum(axis=1) > 0
        tried = np.flatnonzero(turned_to[faces])
        blocked = blockers(geometry.tree, points[tried], lamp[:3] - points[tried]) >= 0
        n_lit = np.bincount(faces[tried[~blocked]], minlength=len(states))
        states[:, k] = np.where(n_lit == 0, DARK, np.where(n_lit == n_points, LIT, IN_PART))
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
        ab, ac = _side(vertices, a, b), _side(vertices, a, c)
        nx = ab[1] * ac[2] - ab[2] * ac[1]
        ny = ab[2] * ac[0] - ab[0] * ac[2]
        nz = ab[0] * ac[1] - ab[1] * ac[0]
        normal = (nx, ny, nz)
        area, base = np.sqrt(_square(normal)), np.sqrt(_square(ab))
        n_rows = 2 + int(area / base / _SPACING)
        for row in range(n_rows):
            t = _INSET + (1 - 2 * _INSET) * np.float32(row / (n_rows - 1))
            n_columns = 2 + int((1 - t) * base / _SPACING)
            for column in range(n_columns):
                s = _INSET + (1 - 2 * _INSET) * np.float32(column / (n_columns - 1))
                if count < len(faces):
                    for k in range(3):
                        along = vertices[a, k] + s * (1 - t) * ab[k] + t * ac[k]
                        points[count, k] = along + LIFT / area * normal[k]
                    faces[count] = face
                count += 1
    return count


@njit(inline="always")
def _side(vertices, i, j):  # type: ignore[no-untyped-def]
    """From one corner to another."""
    x, y, z = vertices[i, 0], vertices[i, 1], vertices[i, 2]
    return vertices[j, 0] - x, vertices[j, 1] - y, vertices[j, 2] - z


@njit(inline="always")
def _square(side):  # type: ignore[no-untyped-def]
    x, y, z = side
    return np.float32(x * x) + np.float32(y * y) + np.float32(z * z)


@njit(inline="always")
def _longest_first(vertices, triangle):  # type: ignore[no-untyped-def]
    """The corners of a triangle, in its order of turning, with its longest side first."""
    a, b, c = triangle[0], triangle[1], triangle[2]
    ab, bc, ca = (
        _square(_side(vertices, a, b)),
        _square(_side(vertices, b, c)),
        _square(_side(vertices, c, a)),
    )
    if bc > ab and bc >= ca:
        return b, c, a
    if ca > ab and ca > bc:
        return c, a, b
    return a, b, c


MARGIN = 0.12
"""How far around the part the light on the table is mapped, [m]."""

_SKY_CELL, _CELL = 0.004, 0.001
"""Spacing of the map's points, at which sky and lamps are looked for, [m]."""

_FLAT = np.float32(0.02)
"""What a ray must fall towards the table, at unit depth, to be said to meet it."""


class Table(NamedTuple):
    """A plane at the height z, and a map of the radiance that it scatters around the part.

    The map's points are `cell` apart, and the first is at (x, y). Beyond them the table is lit
    by every lamp, and by the ambient light in full. The table scatters light evenly, so that its
    radiance is the same from every side.
    """

    z: np.float32
    albedo: np.float32
    radiance: Floats
    x: np.float32
    y: np.float32
    cell: np.float32
    lamps: Floats
    ambient: np.float32


def lay_table(geometry: Geometry, lighting: Lighting) -> Table:
    """The table that the part stands on and throws its shadows on."""
    bounds, lamps = geometry.mesh.bounds, lighting.lamp_rows()
    coarse, fine = (_points(bounds, cell) for cell in (_SKY_CELL, _CELL))
    up = np.zeros_like(coarse)
    up[..., 2] = 1
    sky = share_of_sky(geometry.tree, coarse.reshape(-1, 3), up.reshape(-1, 3))
    size = fine.shape[1::-1]
    light = lighting.ambient * cv2.resize(sky.reshape(coarse.shape[:2]), size)
    for lamp in lamps:
        ways = (lamp[:3] - fine).reshape(-1, 3)
        shaded = blockers(geometry.tree, fine.reshape(-1, 3), ways) >= 0
        lit = lamp[3] * ways[:, 2] / np.linalg.norm(ways, axis=1) ** 3
        light += np.where(shaded, 0, lit).reshape(light.shape)
    albedo = np.float32(TABLE.albedo)
    return Table(
        z=bounds[0, 2],
        albedo=albedo,
        radiance=albedo * light.astype(np.float32),
        x=fine[0, 0, 0],
        y=fine[0, 0, 1],
        cell=np.float32(_CELL),
        lamps=lamps,
        ambient=np.float32(lighting.ambient),
    )


@njit(inline="always")
def table_radiance(cx, cy, cz, dx, dy, dz, z, albedo, grid, x0, y0, cell, lamps, ambient):  # type: ignore[no-untyped-def]
    """Radiance along the ray from (cx, cy, cz); the further arguments are those of `Table`."""
    if dz > -_FLAT:
        return np.float32(0)
    t = (z - cz) / dz
    x, y = cx + t * dx, cy + t * dy
    u, v = (x - x0) / cell, (y - y0) / cell
    if 0 <= u < grid.shape[1] - 1 and 0 <= v < grid.shape[0] - 1:
        column, row = np.int32(u), np.int32(v)
        u, v = u - np.float32(column), v - np.float32(row)
        top = grid[row, column] + u * (grid[row, column + 1] - grid[row, column])
        low = grid[row + 1, column] + u * (grid[row + 1, column + 1] - grid[row + 1, column])
        return top + v * (low - top)
    return albedo * light_at(lamps, ambient, x, y, z)


def _points(bounds: Floats, cell: float) -> Floats:
    low, high = bounds[:, :2] + np.array([[-MARGIN], [MARGIN]])
    x, y = (np.arange(a, b, cell) for a, b in zip(low, high, strict=True))
    points = np.stack([*np.meshgrid(x, y), np.full((len(y), len(x)), bounds[0, 2])], axis=-1)
    return points.astype(np.float32)
