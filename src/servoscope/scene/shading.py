"""Shading, fused into a few passes over the rays: aim, locate, cast shadows, add light.

Embree only says which triangle a ray meets, and where in it. Rays that pass the part's bounding
box never reach it: the table is a plane.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Integers = NDArray[np.int32]

_LIFT = np.float32(1e-4)
"""How far off its surface a shadow ray starts, [m]."""

_FLAT = np.float32(0.02)
"""What a ray must fall towards the table, at unit depth, to be said to meet it."""


class Surroundings(NamedTuple):
    """What the passes need to know of the part, the table and the grain of surfaces."""

    vertices: Floats
    normals: Floats
    sky: Floats
    triangles: Integers
    materials: NDArray[np.uint8]
    looks: Floats
    grain: Floats
    bounds: Floats
    table_sky: Floats
    table_origin: Floats
    table_cell: np.float32
    ambient: np.float32


class Surface(NamedTuple):
    """What the rays met: place, normal, and albedo, specular and shininess there."""

    points: Floats
    normals: Floats
    looks: Floats


@njit(cache=True)
def aim(corners, pixels, offsets, rotation, centre, bounds, rays, towards_part):  # type: ignore[no-untyped-def]
    """Turn pixels into rays; returns how many of them may meet the part.

    Parameters
    ----------
    corners : ndarray of shape (n + 1, n + 1, 2), float32
        Camera coordinates, at unit depth, of the corners of the n x n pixels.
    pixels : ndarray of shape (n_pixels,), int32
        Row times n plus column.
    offsets : ndarray of shape (n_offsets, 2), float32
        Where in each pixel rays pass, from its left and top, [px].
    rotation, centre : ndarray of shapes (3, 3) and (3,), float32
        Of the camera, camera to world.
    bounds : ndarray of shape (2, 3), float32
    rays : ndarray of shape (n_pixels * n_offsets, 3), float32
        Written: directions in the world.
    towards_part : ndarray of shape (n_pixels * n_offsets,), int32
        Written: indices of the rays that meet the bounds.
    """
    n, count, at = corners.shape[0] - 1, 0, 0
    for i in range(pixels.size):
        row, column = pixels[i] // n, pixels[i] % n
        for j in range(offsets.shape[0]):
            u, v = offsets[j, 0], offsets[j, 1]
            x = _bilinear(corners, row, column, row + 1, column + 1, 0, u, v)
            y = _bilinear(corners, row, column, row + 1, column + 1, 1, u, v)
            for k in range(3):
                rays[at, k] = rotation[k, 0] * x + rotation[k, 1] * y + rotation[k, 2]
            if _meets_box(centre, rays[at], bounds):
                towards_part[count] = at
                count += 1
            at += 1
    return count


@njit(cache=True)
def locate_table(rays, centre, around, surface, radiance):  # type: ignore[no-untyped-def]
    """Let every ray meet the table, or nothing; writes `surface` and the ambient `radiance`."""
    table_z = around.bounds[0, 2]
    for i in range(rays.shape[0]):
        if rays[i, 2] > -_FLAT:
            surface.looks[i, :] = 0
            surface.normals[i, :] = 0
            radiance[i] = 0
            continue
        t = (table_z - centre[2]) / rays[i, 2]
        surface.points[i, 0] = centre[0] + t * rays[i, 0]
        surface.points[i, 1] = centre[1] + t * rays[i, 1]
        surface.points[i, 2] = table_z
        surface.normals[i, 0] = surface.normals[i, 1] = 0
        surface.normals[i, 2] = 1
        for k in range(3):
            surface.looks[i, k] = around.looks[0, k]
        sky = _table_sky(surface.points[i, 0], surface.points[i, 1], around)
        radiance[i] = around.ambient * surface.looks[i, 0] * sky


@njit(cache=True)
def locate_part(towards_part, triangle, u, v, around, surface, radiance):  # type: ignore[no-untyped-def]
    """Put the points where rays met the part in place of those on the table."""
    p, e1, e2, n = np.zeros((4, 3), np.float32)
    for j in range(towards_part.size):
        if triangle[j] < 0:
            continue
        i, face = towards_part[j], triangle[j]
        a, b, c = around.triangles[face]
        w = 1 - u[j] - v[j]
        for k in range(3):
            e1[k] = around.vertices[b, k] - around.vertices[a, k]
            e2[k] = around.vertices[c, k] - around.vertices[a, k]
            p[k] = around.vertices[a, k] + u[j] * e1[k] + v[j] * e2[k]
            n[k] = w * around.normals[a, k] + u[j] * around.normals[b, k]
            n[k] += v[j] * around.normals[c, k]
        look = around.looks[around.materials[face]]
        mottle = _roughen(p, n, look, around.grain)
        _lift(p, e1, e2)
        for k in range(3):
            surface.points[i, k], surface.normals[i, k] = p[k], n[k]
            surface.looks[i, k] = look[k]
        surface.looks[i, 0] *= mottle
        sky = w * around.sky[a] + u[j] * around.sky[b] + v[j] * around.sky[c]
        radiance[i] = around.ambient * surface.looks[i, 0] * sky


@njit(cache=True)
def aim_at_lamp(surface, lamp, bounds, origins, rays, asked):  # type: ignore[no-untyped-def]
    """Rays from the lamp to where the part may shade it; returns how many.

    Parameters
    ----------
    surface : Surface
    lamp : ndarray of shape (4,), float32
        Position and strength.
    bounds : ndarray of shape (2, 3), float32
    origins, rays : ndarray of shape (n_rays, 3), float32
        Written: a ray starts at the surface and reaches the lamp at 1.
    asked : ndarray of shape (n_rays,), int32
        Written: which points the rays belong to.
    """
    count = 0
    for i in range(surface.points.shape[0]):
        cosine = np.float32(0)
        for k in range(3):
            rays[count, k] = lamp[k] - surface.points[i, k]
            cosine += rays[count, k] * surface.normals[i, k]
        if cosine > 0 and _meets_box(surface.points[i], rays[count], bounds):
            for k in range(3):
                origins[count, k] = surface.points[i, k]
            asked[count] = i
            count += 1
    return count


@njit(cache=True)
def add_light(surface, lamp, centre, shaded, radiance):  # type: ignore[no-untyped-def]
    """Add to `radiance` what the lamp does to points that are not shaded: Lambert, Blinn-Phong."""
    for i in range(surface.points.shape[0]):
        if shaded[i]:
            continue
        nl = nv = l2 = v2 = lv = np.float32(0)
        for k in range(3):
            to_lamp = lamp[k] - surface.points[i, k]
            to_eye = centre[k] - surface.points[i, k]
            n = surface.normals[i, k]
            nl += n * to_lamp
            nv += n * to_eye
            l2 += to_lamp * to_lamp
            v2 += to_eye * to_eye
            lv += to_lamp * to_eye
        if nl <= 0:
            continue
        length, depth = np.sqrt(l2), np.sqrt(v2)
        nl, nv, lv = nl / length, nv / depth, lv / (length * depth)
        light = lamp[3] / l2 * surface.looks[i, 0] * nl
        if surface.looks[i, 1] > 0:
            halfway = (nl + nv) / np.sqrt(2 + 2 * lv)
            light += lamp[3] / l2 * surface.looks[i, 1] * nl * halfway ** surface.looks[i, 2]
        radiance[i] += light


@njit(cache=True)
def rough_pixels(radiance, contrast):  # type: ignore[no-untyped-def]
    """Indices of the pixels that differ from one beside, above or below by over `contrast`."""
    n_rows, n_columns = radiance.shape
    rough = np.empty(radiance.size, np.int32)
    count = 0
    for row in range(n_rows):
        for column in range(n_columns):
            here = radiance[row, column]
            if (
                abs(radiance[max(row - 1, 0), column] - here) > contrast
                or abs(radiance[min(row + 1, n_rows - 1), column] - here) > contrast
                or abs(radiance[row, max(column - 1, 0)] - here) > contrast
                or abs(radiance[row, min(column + 1, n_columns - 1)] - here) > contrast
            ):
                rough[count] = row * n_columns + column
                count += 1
    return rough[:count]


@njit(cache=True)
def _meets_box(o, d, bounds):  # type: ignore[no-untyped-def]
    """Whether the ray from o along d meets the box."""
    near, far = np.float32(0), np.float32(np.inf)
    for k in range(3):
        if d[k] == 0:
            if o[k] < bounds[0, k] or o[k] > bounds[1, k]:
                return False
        else:
            inverse = 1 / d[k]
            a, b = (bounds[0, k] - o[k]) * inverse, (bounds[1, k] - o[k]) * inverse
            near, far = max(near, min(a, b)), min(far, max(a, b))
    return near <= far


@njit(cache=True)
def _bilinear(grid, row, column, below, right, k, u, v):  # type: ignore[no-untyped-def]
    top = grid[row, column, k] * (1 - u) + grid[row, right, k] * u
    return top * (1 - v) + (grid[below, column, k] * (1 - u) + grid[below, right, k] * u) * v


@njit(cache=True)
def _table_sky(x, y, around):  # type: ignore[no-untyped-def]
    """Share of the ambient light at a point of the table; all of it far from the part."""
    n_y, n_x = around.table_sky.shape[:2]
    u = (x - around.table_origin[0]) / around.table_cell
    v = (y - around.table_origin[1]) / around.table_cell
    if not (0 <= u < n_x - 1 and 0 <= v < n_y - 1):
        return np.float32(1)
    c, r = np.int32(u), np.int32(v)
    return _bilinear(around.table_sky, r, c, r + 1, c + 1, 0, u - c, v - r)


@njit(cache=True)
def _roughen(p, n, look, grain):  # type: ignore[no-untyped-def]
    """Tilt the normal and return the factor of the albedo, by the grain at a point."""
    mottle, roughness, milled = look[3], look[4], look[5]
    if milled > 0:
        x, y = p[0] - np.float32(0.9), p[1] - np.float32(0.07)
        across, along = np.sqrt(x * x + y * y), y * np.float32(0.1)
    else:
        across, along = p[0] + np.float32(0.6) * p[2], p[1] - np.float32(0.5) * p[2]
    size = grain.shape[0]
    u, v = np.float32(1e3) * across + 2 * size, np.float32(1e3) * along + 2 * size
    column, row = np.int32(u), np.int32(v)
    u, v = u - column, v - row
    column, row = column % size, row % size
    right, below = (column + 1) % size, (row + 1) % size
    n[0] += roughness * _bilinear(grain, row, column, below, right, 1, u, v)
    n[1] += roughness * _bilinear(grain, row, column, below, right, 2, u, v)
    length = np.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
    for k in range(3):
        n[k] /= length
    return max(np.float32(0), 1 + mottle * _bilinear(grain, row, column, below, right, 0, u, v))


@njit(cache=True)
def _lift(p, e1, e2):  # type: ignore[no-untyped-def]
    """Move a point off the triangle that has the edges e1 and e2."""
    x = e1[1] * e2[2] - e1[2] * e2[1]
    y = e1[2] * e2[0] - e1[0] * e2[2]
    z = e1[0] * e2[1] - e1[1] * e2[0]
    step = _LIFT / np.sqrt(x * x + y * y + z * z)
    p[0] += x * step
    p[1] += y * step
    p[2] += z * step
