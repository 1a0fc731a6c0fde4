"""How far away from the camera everything in an image lies."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.scene.geometry import geometry_of
from servoscope.scene.lens import pixel_rays
from servoscope.scene.scene import Scene
from servoscope.scene.textured_plane import TexturedPlane


def render_depth(scene: Scene, T_world_cam: ArrayLike) -> NDArray[np.float32]:
    """Depth along the camera's z of what the middle of each pixel sees.

    Parameters
    ----------
    scene : Scene
        Its covering is looked through.
    T_world_cam : array of shape (4, 4)
        [m].

    Returns
    -------
    ndarray of shape (image_size, image_size), float32
        [m]; infinite where a ray meets nothing.

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
