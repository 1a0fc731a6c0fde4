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


class Part(NamedTuple):
    """What the passes need to know of the part's triangles and of the grain of its surfaces."""

    vertices: Floats
    normals: Floats
    sky: Floats
    triangles: Integers
    materials: NDArray[np.uint8]
    looks: Floats
    grain: Floats


class Table(NamedTuple):
    """The plane under the part, and a map of the light on it around the part.

    ``light[..., 0]`` is the share of the ambient light that arrives at the points of a grid,
    `cell` apart and the first at `origin`; ``light[..., 1 + k]`` is 1 where lamp k shines.
    """

    z: np.float32
    look: Floats
    light: Floats
    origin: Floats
    cell: np.float32


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
            dx, dy, dz = rays[at, 0], rays[at, 1], rays[at, 2]
            if _meets_box(centre[0], centre[1], centre[2], dx, dy, dz, bounds):
                towards_part[count] = at
                count += 1
            at += 1
    return count


@njit(cache=True)
def locate_table(rays, centre, table, ambient, surface, radiance):  # type: ignore[no-untyped-def]
    """Let every ray meet the table, or nothing; writes `surface` and the ambient `radiance`."""
    z, look, light, origin, cell = table
    for i in range(rays.shape[0]):
        if rays[i, 2] > -_FLAT:
            surface.looks[i, :] = 0
            surface.normals[i, :] = 0
            radiance[i] = 0
            continue
        t = (z - centre[2]) / rays[i, 2]
        x, y = centre[0] + t * rays[i, 0], centre[1] + t * rays[i, 1]
        surface.points[i, 0], surface.points[i, 1], surface.points[i, 2] = x, y, z
        surface.normals[i, 0], surface.normals[i, 1], surface.normals[i, 2] = 0, 0, 1
        for k in range(3):
            surface.looks[i, k] = look[k]
        u, v = (x - origin[0]) / cell, (y - origin[1]) / cell
        sky = _on_map(light, u, v, 0) if _within(light, u, v) else np.float32(1)
        radiance[i] = ambient * look[0] * sky


@njit(cache=True)
def locate_part(towards_part, triangle, u, v, part, ambient, surface, radiance):  # type: ignore[no-untyped-def]
    """Put the points where rays met the part in place of those on the table."""
    vertices, normals, open_sky, triangles, materials, looks, grain = part
    p, e1, e2, n = np.zeros((4, 3), np.float32)
    for j in range(towards_part.size):
        if triangle[j] < 0:
            continue
        i, face = towards_part[j], triangle[j]
        a, b, c = triangles[face, 0], triangles[face, 1], triangles[face, 2]
        w = 1 - u[j] - v[j]
        for k in range(3):
            e1[k] = vertices[b, k] - vertices[a, k]
            e2[k] = vertices[c, k] - vertices[a, k]
            p[k] = vertices[a, k] + u[j] * e1[k] + v[j] * e2[k]
            n[k] = w * normals[a, k] + u[j] * normals[b, k] + v[j] * normals[c, k]
        look = looks[materials[face]]
        mottle = _roughen(p, n, look, grain)
        _lift(p, e1, e2)
        for k in range(3):
            surface.points[i, k], surface.normals[i, k] = p[k], n[k]
            surface.looks[i, k] = look[k]
        surface.looks[i, 0] *= mottle
        sky = w * open_sky[a] + u[j] * open_sky[b] + v[j] * open_sky[c]
        radiance[i] = ambient * surface.looks[i, 0] * sky


@njit(cache=True)
def aim_at_lamp(surface, lamp, place, bounds, table, lit, origins, rays, asked):  # type: ignore[no-untyped-def]
    """Rays to the lamp from where the part may shade it; returns how many.

    Parameters
    ----------
    surface : Surface
    lamp : ndarray of shape (4,), float32
        Position and strength.
    place : int
        Of the lamp on the table's map of light.
    bounds : ndarray of shape (2, 3), float32
    table : Table
    lit : ndarray of shape (n_points,), float32
        Written: 0 where the surface faces away, the map's value on the table, else 1.
    origins, rays : ndarray of shape (n_rays, 3), float32
        Written: a ray starts at the surface and reaches the lamp at 1.
    asked : ndarray of shape (n_rays,), int32
        Written: which points the rays belong to.
    """
    z, _, light, origin, cell = table
    points, normals, count = surface.points, surface.normals, 0
    for i in range(points.shape[0]):
        x, y = points[i, 0], points[i, 1]
        dx, dy, dz = lamp[0] - x, lamp[1] - y, lamp[2] - points[i, 2]
        lit[i] = 0
        if dx * normals[i, 0] + dy * normals[i, 1] + dz * normals[i, 2] <= 0:
            continue
        lit[i] = 1
        if points[i, 2] == z:
            u, v = (x - origin[0]) / cell, (y - origin[1]) / cell
            if _within(light, u, v):
                lit[i] = _on_map(light, u, v, place)
                continue
        if _meets_box(x, y, points[i, 2], dx, dy, dz, bounds):
            origins[count, 0], origins[count, 1], origins[count, 2] = x, y, points[i, 2]
            rays[count, 0], rays[count, 1], rays[count, 2] = dx, dy, dz
            asked[count] = i
            count += 1
    return count


@njit(cache=True)
def add_light(surface, lamp, centre, lit, radiance):  # type: ignore[no-untyped-def]
    """Add to `radiance` what the lamp does to points that are lit: Lambert, Blinn-Phong."""
    for i in range(surface.points.shape[0]):
        if lit[i] == 0:
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
        length, depth = np.sqrt(l2), np.sqrt(v2)
        nl, nv, lv = nl / length, nv / depth, lv / (length * depth)
        light = lamp[3] / l2 * surface.looks[i, 0] * nl
        if surface.looks[i, 1] > 0:
            halfway = (nl + nv) / np.sqrt(2 + 2 * lv)
            light += lamp[3] / l2 * surface.looks[i, 1] * nl * halfway ** surface.looks[i, 2]
        radiance[i] += lit[i] * light


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
def _meets_box(x, y, z, dx, dy, dz, bounds):  # type: ignore[no-untyped-def]
    """Whether the ray from (x, y, z) along (dx, dy, dz) meets the box."""
    near, far = _clip(np.float32(0), np.float32(np.inf), x, dx, bounds[0, 0], bounds[1, 0])
    near, far = _clip(near, far, y, dy, bounds[0, 1], bounds[1, 1])
    near, far = _clip(near, far, z, dz, bounds[0, 2], bounds[1, 2])
    return near <= far


@njit(cache=True)
def _clip(near, far, o, d, low, high):  # type: ignore[no-untyped-def]
    """The part of a ray's [near, far] in which it lies between low and high along an axis."""
    if d == 0:
        return (near, far) if low <= o <= high else (np.float32(1), np.float32(0))
    a, b = (low - o) / d, (high - o) / d
    return max(near, min(a, b)), min(far, max(a, b))


@njit(cache=True)
def _within(grid, u, v):  # type: ignore[no-untyped-def]
    return 0 <= u < grid.shape[1] - 1 and 0 <= v < grid.shape[0] - 1


@njit(cache=True)
def _on_map(grid, u, v, k):  # type: ignore[no-untyped-def]
    column, row = np.int32(u), np.int32(v)
    return _bilinear(grid, row, column, row + 1, column + 1, k, u - column, v - row)


@njit(cache=True)
def _bilinear(grid, row, column, below, right, k, u, v):  # type: ignore[no-untyped-def]
    top = grid[row, column, k] * (1 - u) + grid[row, right, k] * u
    return top * (1 - v) + (grid[below, column, k] * (1 - u) + grid[below, right, k] * u) * v


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
