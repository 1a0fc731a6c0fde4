"""Images and depth of a scene, and the light of a textured plane."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from servoscope.compiled import compiled
from servoscope.scene.camera import pixel_rays
from servoscope.scene.geometry import geometry_of
from servoscope.scene.lighting import light_at
from servoscope.scene.scene import T_WORLD_REF, Scene
from servoscope.scene.textured_plane import N_TEXELS, TEXEL, Pyramid, TexturedPlane, pyramid_of
from servoscope.scene.tracing import traced_radiance

Floats = NDArray[np.float32]

_FLAT = np.float32(0.02)
"""What a ray must fall towards the plane, at unit depth, to be said to meet it."""

_COUNT, _PER_METRE = np.int32(N_TEXELS), np.float32(1 / TEXEL)


def plane_radiance(scene: Scene, part: TexturedPlane, T_world_cam: Floats) -> Floats:
    """The light that falls on each pixel from a plane in place of the scene's part.

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
            radiance[row, column] = albedo * light_at(lamps, ambient, x, y, np.float32(0))


@njit(inline="always")
def _albedo_at(texels, starts, x, y, width):  # type: ignore[no-untyped-def]
    """The texture at a point, smoothed over a width in texels, read between two of its copies."""
    finer, last_but_one = np.int32(0), np.int32(starts.size - 2)
    while width >= 2 and finer < last_but_one:
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


def render(
    scene: Scene, T_world_cam: ArrayLike, rng: np.random.Generator | None = None
) -> NDArray[np.uint8]:
    """The image, uint8, that the camera takes from a pose, [m]; without `rng` its sensor has no
    noise.

    Examples
    --------
    >>> from servoscope.scene.scene import T_WORLD_REF
    >>> render(Scene(image_size=64), T_WORLD_REF).shape
    (64, 64)
    """
    pose = np.asarray(T_world_cam, dtype=np.float32)
    return scene.sensor.read_out(_radiance_at(scene, pose.tobytes()), rng)


@lru_cache(maxsize=1)
def _radiance_at(scene: Scene, pose: bytes) -> NDArray[np.float32]:
    """What `render_radiance` gives, kept while the camera stays: images then differ by noise."""
    return render_radiance(scene, np.frombuffer(pose, np.float32).reshape(4, 4).copy())


@lru_cache(maxsize=4)
def prepare(scene: Scene) -> None:
    """Make what all images of a scene need, so that the first one takes no longer than another.

    Building a part and compiling take seconds, which nobody should wait for while a robot moves.
    """
    render(scene, T_WORLD_REF, np.random.default_rng(0))


def render_radiance(scene: Scene, T_world_cam: ArrayLike) -> NDArray[np.float32]:
    """The light that falls on each pixel, 1 being white under full light, float32."""
    pose = np.asarray(T_world_cam, dtype=np.float32)
    if isinstance(scene.part, TexturedPlane):
        radiance = plane_radiance(scene, scene.part, pose)
    else:
        radiance = traced_radiance(scene, scene.part, pose)
    if scene.falloff is not None:
        radiance = scene.falloff.shade(radiance)
    return radiance if scene.covering is None else scene.covering.cover(radiance)


def render_depth(scene: Scene, T_world_cam: ArrayLike) -> NDArray[np.float32]:
    """Depth along the camera's z, [m], of what the middle of each pixel sees, its covering left
    out. It is infinite where a ray meets nothing.

    Examples
    --------
    >>> from servoscope.scene.scene import T_WORLD_REF
    >>> scene = Scene(part=TexturedPlane(), image_size=16)
    >>> round(float(render_depth(scene, T_WORLD_REF)[3, 8]), 6)
    0.55
    """
    pose = np.asarray(T_world_cam, dtype=float)
    seen = pixel_rays(scene.lens, scene.image_size)
    ways = np.concatenate([seen, np.ones_like(seen[..., :1])], axis=-1) @ pose[:3, :3].T
    if isinstance(scene.part, TexturedPlane):
        return _depth_of_level(ways, pose[2, 3], 0.0).astype(np.float32)
    geometry = geometry_of(scene.part)
    rays = ways.reshape(-1, 3).astype(np.float32)
    centre = np.broadcast_to(pose[:3, 3].astype(np.float32), rays.shape)
    found = geometry.tree.run(centre, rays, output=True)
    table = _depth_of_level(ways, pose[2, 3], geometry.mesh.bounds[0, 2])
    hit = (found["primID"] >= 0).reshape(table.shape)
    return np.where(hit, found["tfar"].reshape(table.shape), table).astype(np.float32)


def _depth_of_level(ways: NDArray[np.float64], height: float, level: float) -> NDArray[np.float64]:
    """Where rays from a height meet a horizontal plane, in lengths of the ray."""
    fall = -ways[..., 2]
    depth = np.full(fall.shape, np.inf)
    np.divide(height - level, fall, out=depth, where=(fall > 0) & (height > level))
    return depth
