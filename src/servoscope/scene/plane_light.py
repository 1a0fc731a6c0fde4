"""The light that a textured plane scatters towards the camera."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servoscope.compiled import compiled
from servoscope.scene.lens import pixel_rays
from servoscope.scene.scene import Scene
from servoscope.scene.textured_plane import N_TEXELS, TEXEL, Pyramid, TexturedPlane, pyramid_of

Floats = NDArray[np.float32]

_FLAT = np.float32(0.02)
"""What a ray must fall towards the plane, at unit depth, to be said to meet it."""

_COUNT, _PER_METRE = np.int32(N_TEXELS), np.float32(1 / TEXEL)


def plane_radiance(scene: Scene, part: TexturedPlane, T_world_cam: Floats) -> Floats:
    """The light that falls on each pixel from a plane, shape (image_size, image_size).

    Parameters
    ----------
    scene : Scene
        Its part is not looked at.
    part : TexturedPlane
    T_world_cam : ndarray of shape (4, 4), float32
        [m].

    Notes
    -----
    A texture is read, linearly in place and size, where its texels are half a pixel wide: what
    they are smoothed by is then as wide as a pixel.
    """
    size = scene.image_size
    radiance = np.empty((size, size), np.float32)
    _shade(
        pixel_rays(scene.lens, size),
        np.float32(0.5 / (scene.lens.focal_length * size * TEXEL)),
        np.ascontiguousarray(T_world_cam[:3, :3]),
        np.ascontiguousarray(T_world_cam[:3, 3]),
        pyramid_of(part),
        scene.lighting.lamp_rows(),
        np.float32(scene.lighting.ambient),
        radiance,
    )
    return radiance


@compiled(error_model="numpy")
def _shade(
    rays: Floats,
    texels_per_half_pixel: np.float32,
    rotation: Floats,
    centre: Floats,
    pyramid: Pyramid,
    lamps: Floats,
    ambient: np.float32,
    radiance: Floats,
) -> None:
    """Write the radiance along every ray; the texels are counted at unit depth."""
    texels, starts = pyramid
    r00, r01, r02 = rotation[0, 0], rotation[0, 1], rotation[0, 2]
    r10, r11, r12 = rotation[1, 0], rotation[1, 1], rotation[1, 2]
    r20, r21, r22 = rotation[2, 0], rotation[2, 1], rotation[2, 2]
    cx, cy, cz = centre[0], centre[1], centre[2]
    for row in range(rays.shape[0]):
        for column in range(rays.shape[1]):
            u, v = rays[row, column, 0], rays[row, column, 1]
            fall = -(r20 * u + r21 * v + r22)
            if fall < _FLAT or cz <= 0:
                radiance[row, column] = 0
                continue
            depth = cz / fall
            x = cx + depth * (r00 * u + r01 * v + r02)
            y = cy + depth * (r10 * u + r11 * v + r12)
            albedo = _albedo_at(texels, starts, x, y, texels_per_half_pixel * depth)
            radiance[row, column] = albedo * _light_at(lamps, ambient, x, y)


@njit(inline="always")
def _light_at(lamps, ambient, x, y):  # type: ignore[no-untyped-def]
    """Radiance that a white plane would scatter at a point."""
    light = ambient
    for k in range(lamps.shape[0]):
        lx, ly, lz = lamps[k, 0] - x, lamps[k, 1] - y, lamps[k, 2]
        distance2 = lx * lx + ly * ly + lz * lz
        light += lamps[k, 3] * max(lz, np.float32(0)) / (distance2 * np.sqrt(distance2))
    return light


@njit(inline="always")
def _albedo_at(texels, starts, x, y, width):  # type: ignore[no-untyped-def]
    """The texture at a point, smoothed over a width in texels, read between two of its copies."""
    finer, coarsest = np.int32(0), np.int32(starts.size - 2)
    while width >= 2 and finer < coarsest:
        width *= np.float32(0.5)
        finer += np.int32(1)
    share = min(max(width - np.float32(1), np.float32(0)), np.float32(1))
    u, v = x * _PER_METRE, y * _PER_METRE
    fine = _texel_at(texels, starts[finer], finer, u, v)
    coarse = _texel_at(texels, starts[finer + 1], finer + np.int32(1), u, v)
    return fine + share * (coarse - fine)


@njit(inline="always")
def _texel_at(texels, start, level, u, v):  # type: ignore[no-untyped-def]
    """One copy of the texture at a point, read between four texels."""
    scale = np.float32(1) / np.float32(np.int32(1) << level)
    u, v = u * scale, v * scale
    column, row = np.int32(np.floor(u)), np.int32(np.floor(v))
    u, v = u - np.float32(column), v - np.float32(row)
    count = _COUNT >> level
    last = count - np.int32(1)
    left, right = column & last, (column + np.int32(1)) & last
    above, below = start + (row & last) * count, start + ((row + np.int32(1)) & last) * count
    top = texels[above + left] + u * (texels[above + right] - texels[above + left])
    low = texels[below + left] + u * (texels[below + right] - texels[below + left])
    return top + v * (low - top)
