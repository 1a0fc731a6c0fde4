"""Depth is that of the closed form, and that of triangles met by hand."""

from collections.abc import Callable

import cv2
import numpy as np
import pytest

from servoscope.poses import inverse_transform, poses_from_displacements, rigid_transform
from servoscope.scene.depth import render_depth
from servoscope.scene.lens import Lens
from servoscope.scene.mesh import Mesh
from servoscope.scene.scene import T_WORLD_REF, Scene
from servoscope.scene.textured_plane import TexturedPlane

TILTED = poses_from_displacements(T_WORLD_REF, [[0.01, -0.02, 0.01, 0.2, -0.15, 0.2]], 0.55)[0]
See = Callable[..., np.ndarray]


@pytest.mark.parametrize("distortion", [(0.0, 0.0), (-0.12, 0.04)])
def test_points_at_the_depth_of_a_plane_lie_in_it_and_are_seen_there(
    distortion: tuple[float, float], see: See
) -> None:
    scene = Scene(TexturedPlane(), lens=Lens(distortion=distortion), image_size=48)
    depth = render_depth(scene, TILTED)
    pixels = np.stack(np.meshgrid(np.arange(48.0), np.arange(48.0)), axis=-1)
    points = scene.lens.rays(pixels, 48) * depth[..., None]
    world = points @ TILTED[:3, :3].T + TILTED[:3, 3]
    np.testing.assert_allclose(world[..., 2], 0, atol=1e-6)
    found = see(scene, TILTED, world.reshape(-1, 3)).reshape(pixels.shape)
    np.testing.assert_allclose(found, pixels, atol=1e-3)


def test_deck_and_table_lie_at_their_depths() -> None:
    depth = render_depth(Scene(image_size=128), T_WORLD_REF)
    assert depth.dtype == np.float32
    table = depth[:10]
    np.testing.assert_allclose(table, 0.55 + 0.096, atol=1e-6)
    deck = np.isclose(depth, 0.55, atol=1e-5)
    assert 0.15 < deck.mean() < 0.5
    assert depth.min() > 0.55 - 1e-5
    assert depth.max() < 0.65


def test_depth_ends_at_vertices_or_before_them(head: Mesh, see: See) -> None:
    scene = Scene(image_size=512)
    depth = render_depth(scene, TILTED)
    T_cam_world = inverse_transform(TILTED)
    vertices = head.vertices[::7].astype(float)
    z = vertices @ T_cam_world[2, :3] + T_cam_world[2, 3]
    column, row = see(scene, TILTED, vertices).round().astype(int).T
    inside = (column >= 0) & (column < 512) & (row >= 0) & (row < 512)
    column, row, z = column[inside], row[inside], z[inside]
    assert np.mean(np.abs(depth[row, column] - z) < 1e-3) > 0.3
    nearest_around = cv2.erode(depth, np.ones((3, 3)))[row, column]
    assert np.mean(nearest_around > z + 1e-3) < 0.005


@pytest.mark.parametrize("part", [TexturedPlane(), None])
def test_a_camera_that_looks_at_the_sky_sees_infinitely_far(part: TexturedPlane | None) -> None:
    up = rigid_transform(np.eye(3), [0.0, 0.0, 0.55])
    scene = Scene(image_size=16) if part is None else Scene(part, image_size=16)
    assert np.isposinf(render_depth(scene, up)).all()
