"""What the camera sees from a pose."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.scene.plane_light import plane_radiance
from servoscope.scene.scene import T_WORLD_REF, Scene
from servoscope.scene.textured_plane import TexturedPlane
from servoscope.scene.tracing import traced_radiance


def render(
    scene: Scene, T_world_cam: ArrayLike, rng: np.random.Generator | None = None
) -> NDArray[np.uint8]:
    """The image that the camera takes from a pose.

    Parameters
    ----------
    scene : Scene
    T_world_cam : array of shape (4, 4)
        [m].
    rng : Generator, optional
        Draws the noise of the sensor; without it there is none.

    Returns
    -------
    ndarray of shape (image_size, image_size), uint8

    Examples
    --------
    >>> from servoscope.scene.scene import T_WORLD_REF
    >>> render(Scene(image_size=64), T_WORLD_REF).shape
    (64, 64)
    """
    return scene.sensor.read_out(render_radiance(scene, T_world_cam), rng)


@lru_cache(maxsize=4)
def prepare(scene: Scene) -> None:
    """Make what all images of a scene need, so that the first one takes no longer than another.

    Building a part and compiling take seconds, which nobody should wait for while a robot moves.
    """
    render(scene, T_WORLD_REF, np.random.default_rng(0))


def render_radiance(scene: Scene, T_world_cam: ArrayLike) -> NDArray[np.float32]:
    """The light that falls on each pixel, 1 being white under full light.

    Parameters
    ----------
    scene : Scene
    T_world_cam : array of shape (4, 4)
        [m].

    Returns
    -------
    ndarray of shape (image_size, image_size), float32
    """
    pose = np.asarray(T_world_cam, dtype=np.float32)
    if isinstance(scene.part, TexturedPlane):
        radiance = plane_radiance(scene, scene.part, pose)
    else:
        radiance = traced_radiance(scene, scene.part, pose)
    if scene.falloff is not None:
        radiance = scene.falloff.shade(radiance)
    return radiance if scene.covering is None else scene.covering.cover(radiance)
