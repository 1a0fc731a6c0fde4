"""The light that the part scatters, in one pass over the rays that were sent towards it.

Embree only says which face a ray meets, and where in it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servoscope.scene.grain import N_TEXELS
from servoscope.scene.shadows import DARK, IN_PART, LIFT
from servoscope.scene.table import Table, table_radiance

Floats = NDArray[np.float32]
Integers = NDArray[np.int32]


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


class Hits(NamedTuple):
    """The faces that rays met, -1 for none, and the barycentric coordinates there."""

    face: Integers
    u: Floats
    v: Floats


class Doubts(NamedTuple):
    """Rays towards lamps, from where it is not known whether the lamp shines; it is at 1.

    `gain` is the radiance that is added to `ray_of` if nothing is in the way.
    """

    origins: Floats
    ways: Floats
    ray_of: Integers
    gain: Floats


@njit(cache=True, error_model="numpy")
def shade(
    rays: Floats,
    ray_of: Integers,
    hits: Hits,
    centre: Floats,
    part: Part,
    table: Table,
    radiance: Floats,
    doubts: Doubts,
) -> int:
    """Write the radiance along rays, but for what lamps may add that may be hidden.

    Parameters
    ----------
    rays : ndarray of shape (n_rays, 3), float32
    ray_of : ndarray of shape (n_rays,), int32
        Where in `radiance` each has its place.
    hits : Hits
    centre : ndarray of shape (3,), float32
        Where all rays start, [m].
    part : Part
    table : Table
    radiance : ndarray, float32
        Written.
    doubts : Doubts
        Written; with room for a ray from each of `rays` to each lamp.

    Returns
    -------
    int
        How many doubts there are.
    """
    hit_face, hit_u, hit_v = hits
    vertices, normals, open_sky, triangles, materials, states, looks, grain = part
    z, albedo, grid, x0, y0, cell, lamps, ambient = table
    origins, ways, doubt_of, gain = doubts
    cx, cy, cz = centre[0], centre[1], centre[2]
    one, count = np.float32(1), 0
    for j in range(ray_of.size):
        i, face = ray_of[j], hit_face[j]
        if face < 0:
            dx, dy, dz = rays[j, 0], rays[j, 1], rays[j, 2]
            radiance[i] = table_radiance(
                cx, cy, cz, dx, dy, dz, z, albedo, grid, x0, y0, cell, lamps, ambient
            )
            continue
        a, b, c = triangles[face, 0], triangles[face, 1], triangles[face, 2]
        u, v = hit_u[j], hit_v[j]
        w = one - u - v
        e1x, e2x = vertices[b, 0] - vertices[a, 0], vertices[c, 0] - vertices[a, 0]
        e1y, e2y = vertices[b, 1] - vertices[a, 1], vertices[c, 1] - vertices[a, 1]
        e1z, e2z = vertices[b, 2] - vertices[a, 2], vertices[c, 2] - vertices[a, 2]
        px = vertices[a, 0] + u * e1x + v * e2x
        py = vertices[a, 1] + u * e1y + v * e2y
        pz = vertices[a, 2] + u * e1z + v * e2z
        nx = w * normals[a, 0] + u * normals[b, 0] + v * normals[c, 0]
        ny = w * normals[a, 1] + u * normals[b, 1] + v * normals[c, 1]
        nz = w * normals[a, 2] + u * normals[b, 2] + v * normals[c, 2]
        look = materials[face]
        bump, slope_x, slope_y = _grain_at(grain, px, py, pz, looks[look, 5] > 0)
        diffuse = looks[look, 0] * max(np.float32(0), one + looks[look, 3] * bump)
        nx += looks[look, 4] * slope_x
        ny += looks[look, 4] * slope_y
        shrink = one / np.sqrt(nx * nx + ny * ny + nz * nz)
        nx, ny, nz = nx * shrink, ny * shrink, nz * shrink
        light = ambient * diffuse * (w * open_sky[a] + u * open_sky[b] + v * open_sky[c])
        vx, vy, vz = cx - px, cy - py, cz - pz
        depth = np.sqrt(vx * vx + vy * vy + vz * vz)
        for k in range(lamps.shape[0]):
            if states[face, k] == DARK:
                continue
            lx, ly, lz = lamps[k, 0] - px, lamps[k, 1] - py, lamps[k, 2] - pz
            nl = nx * lx + ny * ly + nz * lz
            if nl <= 0:
                continue
            l2 = lx * lx + ly * ly + lz * lz
            distance = np.sqrt(l2)
            nl /= distance
            nv = (nx * vx + ny * vy + nz * vz) / depth
            lv = (lx * vx + ly * vy + lz * vz) / (distance * depth)
            halfway = max(np.float32(0), (nl + nv) / np.sqrt(np.float32(2) + lv + lv))
            shine = looks[look, 1] * halfway ** looks[look, 2]
            more = lamps[k, 3] / l2 * nl * (diffuse + shine)
            if states[face, k] != IN_PART:
                light += more
                continue
            fx, fy, fz = e1y * e2z - e1z * e2y, e1z * e2x - e1x * e2z, e1x * e2y - e1y * e2x
            lift = LIFT / np.sqrt(fx * fx + fy * fy + fz * fz)
            fx, fy, fz = fx * lift, fy * lift, fz * lift
            origins[count, 0], origins[count, 1], origins[count, 2] = px + fx, py + fy, pz + fz
            ways[count, 0], ways[count, 1], ways[count, 2] = lx - fx, ly - fy, lz - fz
            doubt_of[count], gain[count] = i, more
            count += 1
        radiance[i] = light
    return count


@njit(cache=True)
def add_unblocked(blocker: Integers, ray_of: Integers, gain: Floats, radiance: Floats) -> None:
    """Add to `radiance` what comes along the doubtful rays that nothing blocks (-1)."""
    for j in range(blocker.size):
        if blocker[j] < 0:
            radiance[ray_of[j]] += gain[j]


@njit(inline="always")
def _grain_at(grain, x, y, z, milled):  # type: ignore[no-untyped-def]
    """Unevenness and slopes of a surface at a point."""
    if milled:
        x, y = x - np.float32(0.9), y - np.float32(0.07)
        across, along = np.sqrt(x * x + y * y), y * np.float32(0.1)
    else:
        across, along = x + np.float32(0.6) * z, y - np.float32(0.5) * z
    u = np.float32(1e3) * across + np.float32(2 * N_TEXELS)
    v = np.float32(1e3) * along + np.float32(2 * N_TEXELS)
    column, row = np.int32(u), np.int32(v)
    u, v = u - np.float32(column), v - np.float32(row)
    column, row = column % N_TEXELS, row % N_TEXELS
    right, below = (column + 1) % N_TEXELS, (row + 1) % N_TEXELS
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
