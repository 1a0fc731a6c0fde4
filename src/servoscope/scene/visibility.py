"""Which face of a mesh a camera sees along each of its rays: a depth buffer."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servoscope.compiled import compiled
from servoscope.scene.camera import Lens
from servoscope.scene.vectors import cross, dot, minus, row_of

Floats = NDArray[np.float32]
Integers = NDArray[np.int32]


class RayGrid(NamedTuple):
    """A ray for each of n x n pixels, all from one point.

    Parameters
    ----------
    x, y : ndarray of shape (n, n)
        Where the rays pass at unit depth.
    right, down : float
        How far from the middle of its pixel each ray passes, [px].
    bend_x, bend_y : float
        The largest second difference of x and y along a row: how far rows are from straight.
    """

    x: Floats
    y: Floats
    right: float
    down: float
    bend_x: float
    bend_y: float


@lru_cache(maxsize=12)
def ray_grid(lens: Lens, n: int, right: float, down: float) -> RayGrid:
    """The rays that pass so far from the middles of n x n pixels; read between their corners."""
    edges = np.arange(n + 1) - 0.5
    grid = np.stack(np.meshgrid(edges, edges))
    corners = np.moveaxis(lens.rays(np.moveaxis(grid, 0, -1), n)[..., :2], -1, 0).astype(np.float32)
    u, v = np.float32(right + 0.5), np.float32(down + 0.5)
    above = corners[..., :-1] + u * (corners[..., 1:] - corners[..., :-1])
    x, y = np.ascontiguousarray(above[:, :-1] + v * (above[:, 1:] - above[:, :-1]))
    bend_x, bend_y = (float(np.abs(np.diff(z.astype(float), 2)).max()) for z in (x, y))
    return RayGrid(x, y, right, down, bend_x, bend_y)


class Outlines(NamedTuple):
    """The faces that turn towards a camera and may be in its view.

    A ray (x, y, 1) meets a face where three linear forms of it, U, V and W, are not negative. Then
    D = U + V + W is the inverse of the depth, [1/m], and U / D and V / D are the barycentric
    coordinates.

    Parameters
    ----------
    faces : ndarray of shape (n_faces,)
    forms : ndarray of shape (n_faces, 9)
        The coefficients of U, V and W.
    bounds : ndarray of shape (n_faces, 4)
        The least and the largest column, and row, of where a face may be seen, counted from 1.
    """

    faces: Integers
    forms: NDArray[np.float64]
    bounds: NDArray[np.float64]


def outlines(
    vertices: Floats, triangles: Integers, T_world_cam: Floats, lens: Lens, n: int
) -> Outlines:
    """The outlines of a closed mesh, [m], in an image of n x n pixels.

    Faces that turn away are left out, but for a camera within the bounds of the mesh.
    """
    K = lens.camera_matrix(n)
    n_faces = len(triangles)
    found = Outlines(np.empty(n_faces, np.int32), np.empty((n_faces, 9)), np.empty((n_faces, 4)))
    count = _outline(
        vertices,
        triangles,
        T_world_cam[:3, :3].astype(float),
        T_world_cam[:3, 3].astype(float),
        (K[0, 0], K[0, 2], K[1, 2], *lens.distortion),
        n,
        found,
    )
    return Outlines(found.faces[:count], found.forms[:count], found.bounds[:count])


class Hits(NamedTuple):
    """The faces that rays meet, -1 for none, and the barycentric coordinates there."""

    face: Integers
    u: Floats
    v: Floats


def first_hits(outlines: Outlines, grid: RayGrid, pixels: Integers) -> Hits:
    """What the rays of some pixels, row times n plus column, meet first."""
    hits = Hits(np.empty(len(pixels), np.int32), *np.empty((2, len(pixels)), np.float32))
    _first_hits(outlines, grid, pixels, hits)
    return hits


_EDGE_ON = 1e-30
"""Faces of a smaller volume with the camera are edge on, [m^3]."""

_NEAREST = 1e-6
"""A face that comes nearer than this to the camera's plane is looked for everywhere, [m]."""

_MARGIN = 0.01
"""How far beyond its bounds a face is looked for, [px]; what rays are off the lens's is less."""


@compiled(error_model="numpy")
def _outline(
    vertices: Floats,
    triangles: Integers,
    rotation: NDArray[np.float64],
    centre: NDArray[np.float64],
    projection: tuple[float, float, float, float, float],
    n: int,
    found: Outlines,
) -> int:
    """Write the outlines; returns how many there are."""
    faces, forms, bounds = found
    points = np.empty((vertices.shape[0], 3))
    is_within = True
    for k in range(3):
        is_within &= vertices[:, k].min() <= centre[k] <= vertices[:, k].max()
    for i in range(vertices.shape[0]):
        x, y, z = vertices[i, 0] - centre[0], vertices[i, 1] - centre[1], vertices[i, 2] - centre[2]
        for k in range(3):
            points[i, k] = rotation[0, k] * x + rotation[1, k] * y + rotation[2, k] * z
    count = 0
    for face in range(triangles.shape[0]):
        a = row_of(points, triangles[face, 0])
        b = row_of(points, triangles[face, 1])
        c = row_of(points, triangles[face, 2])
        ab, ac = minus(b, a), minus(c, a)
        normal = cross(ab, ac)
        away = dot(normal, a)
        if abs(away) < _EDGE_ON or (away > 0 and not is_within):
            continue
        left, right, top, bottom = _bounds(a, b, c, projection)
        if right < -0.5 or left > n - 0.5 or bottom < -0.5 or top > n - 0.5:
            continue
        u, v, scale = cross(ac, a), cross(a, ab), 1 / away
        for k in range(3):
            forms[count, k], forms[count, 3 + k] = scale * u[k], scale * v[k]
            forms[count, 6 + k] = scale * (normal[k] - u[k] - v[k])
        for k, edge in enumerate((left, right, top, bottom)):
            bounds[count, k] = 1 + min(max(edge, -0.5), n)
        faces[count] = face
        count += 1
    return count


@njit(inline="always")
def _bounds(a, b, c, projection):  # type: ignore[no-untyped-def]
    """Least and largest column and row in which a triangle may be seen, by interval arithmetic."""
    nearest, farthest = min(a[2], b[2], c[2]), max(a[2], b[2], c[2])
    if farthest <= 0:
        return np.inf, -np.inf, np.inf, -np.inf
    if nearest < _NEAREST:
        return -np.inf, np.inf, -np.inf, np.inf
    focal, cx, cy, k1, k2 = projection
    xa, xb, xc = a[0] / a[2], b[0] / b[2], c[0] / c[2]
    ya, yb, yc = a[1] / a[2], b[1] / b[2], c[1] / c[2]
    x0, x1 = min(xa, xb, xc), max(xa, xb, xc)
    y0, y1 = min(ya, yb, yc), max(ya, yb, yc)
    low = max(x0, -x1, 0.0) ** 2 + max(y0, -y1, 0.0) ** 2
    high = max(-x0, x1) ** 2 + max(-y0, y1) ** 2
    s0 = 1 + min(k1 * low, k1 * high) + min(k2 * low * low, k2 * high * high)
    s1 = 1 + max(k1 * low, k1 * high) + max(k2 * low * low, k2 * high * high)
    return (
        focal * min(x0 * s0, x0 * s1) + cx - _MARGIN,
        focal * max(x1 * s0, x1 * s1) + cx + _MARGIN,
        focal * min(y0 * s0, y0 * s1) + cy - _MARGIN,
        focal * max(y1 * s0, y1 * s1) + cy + _MARGIN,
    )


_NARROW = 6
"""Rows of a face that are narrower than this are not worth being narrowed, [px]."""


@compiled(error_model="numpy")
def _first_hits(outlines: Outlines, grid: RayGrid, pixels: Integers, hits: Hits) -> None:
    """Write what is met first: the face with the largest inverse of the depth."""
    faces, forms, bounds = outlines
    x, y, right, down, bend_x, bend_y = grid
    n = np.int32(len(x))
    nearness, nearest = np.zeros((n, n), np.float32), np.full((n, n), -1, np.int32)
    following = _following(n, pixels)
    for j in range(faces.size):
        left, last = np.int32(bounds[j, 0] - right), min(np.int32(bounds[j, 1] - right), n) - 1
        top, low = np.int32(bounds[j, 2] - down), min(np.int32(bounds[j, 3] - down), n) - 1
        width = last - left
        if width < 0:
            continue
        u, v, w = _form(forms, j, 0), _form(forms, j, 3), _form(forms, j, 6)
        for row in range(np.uint32(top), np.uint32(low + 1)):
            if following[row, np.uint32(left)] > last:
                continue
            start, stop = 0.0, np.float64(width)
            if width >= _NARROW:
                a, b = np.uint32(left), np.uint32(last)
                ends = x[row, a], y[row, a], x[row, b], y[row, b]
                start, stop = _narrowed(start, stop, width, u, ends, bend_x, bend_y)
                start, stop = _narrowed(start, stop, width, v, ends, bend_x, bend_y)
                start, stop = _narrowed(start, stop, width, w, ends, bend_x, bend_y)
                if stop < start:
                    continue
            column = np.uint32(following[row, np.uint32(left + start)])
            end = np.uint32(left + stop)
            while column <= end:
                xi, yi = x[row, column], y[row, column]
                p, q, r = _value(u, xi, yi), _value(v, xi, yi), _value(w, xi, yi)
                nearer = p + q + r - nearness[row, column]
                if min(min(p, q), min(r, nearer)) >= 0:
                    nearness[row, column] = p + q + r
                    nearest[row, column] = j
                column = np.uint32(following[row, column + np.uint32(1)])
    for i in range(pixels.size):
        place = np.uint32(pixels[i])
        met = nearest.flat[place]
        hits.face[i] = -1
        if met >= 0:
            xi, yi = x.flat[place], y.flat[place]
            hits.face[i] = faces[met]
            p, q = _value(_form(forms, met, 0), xi, yi), _value(_form(forms, met, 3), xi, yi)
            scale = 1 / (p + q + _value(_form(forms, met, 6), xi, yi))
            hits.u[i], hits.v[i] = scale * p, scale * q


@njit(inline="always")
def _narrowed(start, stop, width, form, ends, bend_x, bend_y):  # type: ignore[no-untyped-def]
    """The part of a row where a form may not be negative, between its ends `width` apart."""
    slack = (abs(form[0]) * bend_x + abs(form[1]) * bend_y) * width * width * 0.125
    a = _value(form, ends[0], ends[1]) + slack
    b = _value(form, ends[2], ends[3]) + slack
    if a < 0 and b < 0:
        stop = -1.0
    elif a < 0:
        start = max(start, width * a / (a - b))
    elif b < 0:
        stop = min(stop, width * a / (a - b))
    return start, stop


@njit(inline="always")
def _form(forms, j, k):  # type: ignore[no-untyped-def]
    return forms[j, k], forms[j, k + 1], forms[j, k + 2]


@njit(inline="always")
def _value(form, x, y):  # type: ignore[no-untyped-def]
    return form[0] * x + form[1] * y + form[2]


@compiled()
def _following(n: int, pixels: Integers) -> NDArray[np.uint16]:
    """The column of the next of the pixels in a row from each column on; n for none."""
    following = np.full((n, n + 1), n, np.uint16)
    for pixel in pixels:
        following[pixel // n, pixel % n] = pixel % n
    for row in range(n):
        for column in range(n - 1, -1, -1):
            following[row, column] = min(following[row, column], following[row, column + 1])
    return following
