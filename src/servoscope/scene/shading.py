"""What surfaces scatter towards the camera."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servoscope.compiled import compiled
from servoscope.scene.geometry import DARK, IN_PART, LIFT, Table, table_radiance
from servoscope.scene.mesh import N_TEXELS
from servoscope.scene.vectors import blend, cross, dot, minus, of_length, plus, row_of, turned
from servoscope.scene.visibility import Hits, RayGrid

Floats = NDArray[np.float32]
Integers = NDArray[np.int32]

_LAST = N_TEXELS - 1  # a tile has a power of two of texels a side


class Part(NamedTuple):
    """What the shading needs to know of the part's triangles and of the grain of its surfaces."""

    vertices: Floats
    normals: Floats
    sky: Floats
    triangles: Integers
    materials: NDArray[np.uint8]
    states: NDArray[np.uint8]
    looks: Floats
    grain: Floats


class ShadowRays(NamedTuple):
    """Rays towards lamps from faces that are lit in part; the lamp is at 1.

    `gain` is the radiance that is added to `ray_of` if nothing is in the way.
    """

    origins: Floats
    directions: Floats
    ray_of: Integers
    gain: Floats


@compiled(error_model="numpy")
def shade(
    hits: Hits,
    pixels: Integers,
    grid: RayGrid,
    rotation: Floats,
    centre: Floats,
    part: Part,
    table: Table,
    radiance: Floats,
    shadow_rays: ShadowRays,
) -> int:
    """Write the radiance along the rays of some pixels, but for what lamps may add that may be
    hidden.

    `pixels` are row times n plus column; the camera's pose are a rotation and its centre, [m].
    Written are `radiance` and `shadow_rays`, which have room for one from each hit to each lamp.
    Returns how many of these there are.
    """
    vertices, normals, open_sky, triangles, materials, states, looks, grain = part
    lamps, count = table.lamps, 0
    eye = row_of(centre.reshape(1, 3), 0)
    for i in range(pixels.size):
        face = hits.face[i]
        if face < 0:
            ray = grid.x.flat[pixels[i]], grid.y.flat[pixels[i]], np.float32(1)
            radiance[i] = _light_of_table(eye, turned(rotation, ray), table)
            continue
        a, b, c = row_of(triangles, face)
        u, v = hits.u[i], hits.v[i]
        w = np.float32(1) - u - v
        corner = row_of(vertices, a)
        e1, e2 = minus(row_of(vertices, b), corner), minus(row_of(vertices, c), corner)
        point = blend(np.float32(1), corner, u, e1, v, e2)
        normal = blend(w, row_of(normals, a), u, row_of(normals, b), v, row_of(normals, c))
        look = looks[materials[face]]
        normal, diffuse = _grained(normal, point, look, grain)
        sky = w * open_sky[a] + u * open_sky[b] + v * open_sky[c]
        light = table.ambient * diffuse * sky
        for k in range(lamps.shape[0]):
            if states[face, k] == DARK:
                continue
            to_lamp = minus(row_of(lamps, k), point)
            more = _scattered(lamps[k, 3], normal, to_lamp, minus(eye, point), diffuse, look)
            if states[face, k] != IN_PART:
                light += more
            elif more > 0:
                off = of_length(cross(e1, e2), LIFT)
                _write_shadow_ray(shadow_rays, count, point, to_lamp, off)
                shadow_rays.ray_of[count], shadow_rays.gain[count] = i, more
                count += 1
        radiance[i] = light
    return count


@compiled()
def add_unblocked(blocker: Integers, ray_of: Integers, gain: Floats, radiance: Floats) -> None:
    """Add to `radiance` what comes along the shadow rays that nothing blocks (-1)."""
    for j in range(blocker.size):
        if blocker[j] < 0:
            radiance[ray_of[j]] += gain[j]


@njit(inline="always")
def _light_of_table(eye, ray, table):  # type: ignore[no-untyped-def]
    """Radiance along a ray that misses the part."""
    cx, cy, cz = eye
    dx, dy, dz = ray
    z, albedo, grid, x0, y0, cell, lamps, ambient = table
    return table_radiance(cx, cy, cz, dx, dy, dz, z, albedo, grid, x0, y0, cell, lamps, ambient)


@njit(inline="always")
def _scattered(strength, normal, to_lamp, to_eye, diffuse, look):  # type: ignore[no-untyped-def]
    """Radiance that a lamp adds at a point, by Lambert and Blinn-Phong."""
    nl = dot(normal, to_lamp)
    if nl > 0:
        l2, depth = dot(to_lamp, to_lamp), np.sqrt(dot(to_eye, to_eye))
        distance = np.sqrt(l2)
        nl /= distance
        nv = dot(normal, to_eye) / depth
        lv = dot(to_lamp, to_eye) / (distance * depth)
        halfway2 = max(np.float32(0), nl + nv) ** 2 / (np.float32(2) + lv + lv)
        shine = look[1] * _power(halfway2, np.int32(look[2]) >> 1)
        more = strength / l2 * nl * (diffuse + shine)
    else:
        more = np.float32(0)
    return more


@njit(inline="always")
def _power(base, exponent):  # type: ignore[no-untyped-def]
    """A number to a whole power, by squaring."""
    result = np.float32(1)
    while exponent > 0:
        if exponent & 1:
            result *= base
        base *= base
        exponent >>= 1
    return result


@njit(inline="always")
def _write_shadow_ray(rays, place, point, to_lamp, off):  # type: ignore[no-untyped-def]
    """Write the ray to a lamp from a point that is lifted off its face."""
    origins, directions = rays.origins, rays.directions
    origins[place, 0], origins[place, 1], origins[place, 2] = plus(point, off)
    directions[place, 0], directions[place, 1], directions[place, 2] = minus(to_lamp, off)


@njit(inline="always")
def _grained(normal, point, look, grain):  # type: ignore[no-untyped-def]
    """Normal and albedo of a surface at a point, with its grain."""
    bump, slope_x, slope_y = _grain_at(grain, point, look[5] > 0)
    diffuse = look[0] * max(np.float32(0), np.float32(1) + look[3] * bump)
    tilted = normal[0] + look[4] * slope_x, normal[1] + look[4] * slope_y, normal[2]
    return of_length(tilted, np.float32(1)), diffuse


@njit(inline="always")
def _grain_at(grain, point, milled):  # type: ignore[no-untyped-def]
    """Unevenness and slopes of a surface at a point."""
    x, y, z = point
    if milled:
        x, y = x - np.float32(0.9), y - np.float32(0.07)
        across, along = np.sqrt(x * x + y * y), y * np.float32(0.1)
    else:
        across, along = x + np.float32(0.6) * z, y - np.float32(0.5) * z
    u = np.float32(1e3) * across + np.float32(2 * N_TEXELS)
    v = np.float32(1e3) * along + np.float32(2 * N_TEXELS)
    column, row = np.int32(u), np.int32(v)
    u, v = u - np.float32(column), v - np.float32(row)
    column, row = np.uint32(column & _LAST), np.uint32(row & _LAST)
    right, below = np.uint32((column + 1) & _LAST), np.uint32((row + 1) & _LAST)
    one = np.float32(1)
    top, low = (one - u) * (one - v), u * (one - v)
    left, far = (one - u) * v, u * v
    return (
        top * grain[row, column, 0]
        + low * grain[row, right, 0]
        + left * grain[below, column, 0]
        + far * grain[below, right, 0],
        top * grain[row, column, 1]
        + low * grain[row, right, 1]
        + left * grain[below, column, 1]
        + far * grain[below, right, 1],
        top * grain[row, column, 2]
        + low * grain[row, right, 2]
        + left * grain[below, column, 2]
        + far * grain[below, right, 2],
    )
