"""Images show each thing where a pinhole camera sees it, with its light and at its depth."""

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from servoscope.errors import InvalidInputError
from servoscope.poses import inverse_transform, poses_from_displacements, rigid_transform
from servoscope.scene.camera import Lens, Sensor
from servoscope.scene.lighting import Lighting, PointLight
from servoscope.scene.mesh import TABLE, Mesh
from servoscope.scene.render import render, render_depth, render_radiance
from servoscope.scene.scene import T_WORLD_REF, Scene
from servoscope.scene.textured_plane import TexturedPlane

TABLE_Z = -0.096
BOLT_HOLES = [(0.024, 0.053), (0.024, -0.053), (-0.057, 0.053), (0.105, 0.053)]
RIM = 0.008  # where the chamfer of a bolt hole meets the deck
OVER_BARE_TABLE = rigid_transform(np.diag([1.0, -1.0, -1.0]), [0.0, 0.75, 0.55])
See = Callable[..., np.ndarray]


def _tilted(angles_deg: tuple[float, float, float]) -> np.ndarray:
    turn = Rotation.from_euler("xyz", angles_deg, degrees=True).as_matrix()
    pivot = rigid_transform(np.eye(3), [0, 0, 0.55])
    away = rigid_transform(np.eye(3), [0, 0, -0.55])
    return T_WORLD_REF @ pivot @ rigid_transform(turn, [0.01, -0.005, 0.02]) @ away


@pytest.mark.parametrize("angles_deg", [(0, 0, 0), (12, -8, 10), (-14, 14, -15)])
@pytest.mark.parametrize("distortion", [(-0.12, 0.04), (0.5, 0.0)])
def test_bolt_holes_are_where_opencv_projects_their_rims(
    angles_deg: tuple[float, float, float], distortion: tuple[float, float], see: See
) -> None:
    scene = Scene(image_size=400, lens=Lens(distortion=distortion))
    T_world_cam = _tilted(angles_deg)
    dark = (render_radiance(scene, T_world_cam) < 0.38).astype(np.uint8)
    turn = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    for x, y in BOLT_HOLES:
        rim = [[x + RIM * np.cos(a), y + RIM * np.sin(a), 0.0] for a in turn]
        outline = see(scene, T_world_cam, rim)
        inside, ring = np.zeros((2, 400, 400), np.uint8)
        cv2.fillPoly(inside, [np.round(outline).astype(np.int32)], 1)
        ring = cv2.dilate(inside, np.ones((7, 7), np.uint8)) - inside
        hole = dark * cv2.dilate(inside, np.ones((3, 3), np.uint8))
        assert hole.sum() == pytest.approx(cv2.contourArea(outline.astype(np.float32)), rel=0.12)
        centre = np.argwhere(hole)[:, ::-1].mean(axis=0)
        np.testing.assert_allclose(centre, outline.mean(axis=0), atol=0.5)
        assert dark[ring > 0].mean() < 0.2


def test_bare_table_has_the_light_of_the_closed_form() -> None:
    scene = Scene(image_size=128)
    radiance = render_radiance(scene, OVER_BARE_TABLE)
    pixels = np.stack(np.meshgrid(np.arange(128.0), np.arange(128.0)), axis=-1)
    K, distortion = scene.lens.camera_matrix(128), np.array([*scene.lens.distortion, 0, 0])
    ideal = cv2.undistortPoints(pixels.reshape(-1, 1, 2), K, distortion).reshape(128, 128, 2)
    depth = OVER_BARE_TABLE[2, 3] - TABLE_Z
    x, y = depth * ideal[..., 0], OVER_BARE_TABLE[1, 3] - depth * ideal[..., 1]
    expected = np.full((128, 128), scene.lighting.ambient)
    for lamp in scene.lighting.lamps:
        to_lamp = np.array(lamp.position) - np.stack([x, y, np.full_like(x, TABLE_Z)], axis=-1)
        distance = np.linalg.norm(to_lamp, axis=-1)
        expected += lamp.strength * to_lamp[..., 2] / distance**3
    np.testing.assert_allclose(radiance, TABLE.albedo * expected, rtol=2e-4)


def test_light_on_the_table_near_the_part_is_that_of_the_closed_form(see: See) -> None:
    lamp = PointLight(position=(0.0, -1.0, 1.0), strength=0.7)
    scene = Scene(lighting=Lighting(lamps=(lamp,), ambient=0.0), image_size=128)
    radiance = render_radiance(scene, T_WORLD_REF)
    for x, y in [(0.0, -0.13), (0.05, -0.15), (-0.08, -0.16)]:
        column, row = see(scene, T_WORLD_REF, [[x, y, TABLE_Z]])[0].round().astype(int)
        to_lamp = np.array(lamp.position) - [x, y, TABLE_Z]
        expected = TABLE.albedo * lamp.strength * to_lamp[2] / np.linalg.norm(to_lamp) ** 3
        assert radiance[row, column] == pytest.approx(expected, rel=0.01)


def test_without_lamps_the_bare_table_has_the_ambient_light_alone() -> None:
    scene = Scene(lighting=Lighting(lamps=(), ambient=0.5), image_size=32)
    np.testing.assert_allclose(render_radiance(scene, OVER_BARE_TABLE), 0.5 * 0.9, rtol=1e-6)


def test_table_beside_the_part_sees_less_of_the_sky(see: See) -> None:
    scene = Scene(lighting=Lighting(lamps=(), ambient=1.0), image_size=128)
    radiance = render_radiance(scene, T_WORLD_REF)
    column, row = see(scene, T_WORLD_REF, [[0.02, -0.098, TABLE_Z]])[0].round().astype(int)
    assert 0.3 < radiance[row, column] < 0.75
    assert 0.75 < radiance[-1, 64] < 0.9


@pytest.mark.parametrize("side", [-1, 1])
def test_the_shadow_falls_away_from_the_lamp(side: int, see: See) -> None:
    lamp = PointLight(position=(0.0, -side * 1.0, 1.0), strength=1.0)
    scene = Scene(lighting=Lighting(lamps=(lamp,), ambient=0.1), image_size=128)
    radiance = render_radiance(scene, T_WORLD_REF)
    points = [[0.0, side * 0.13, TABLE_Z], [0.0, -side * 0.13, TABLE_Z]]
    (u, v), (u_lit, v_lit) = see(scene, T_WORLD_REF, points).round().astype(int)
    assert radiance[v, u] < 0.09
    assert radiance[v_lit, u_lit] > 3 * radiance[v, u]


def test_a_hole_in_the_part_lies_in_shadow_that_the_deck_does_not(see: See) -> None:
    lamp = PointLight(position=(0.6, 0.0, 0.8), strength=1.0)
    lit, unlit = (
        render_radiance(
            Scene(lighting=Lighting(lamps=lamps, ambient=0.4), image_size=256), T_WORLD_REF
        )
        for lamps in ((lamp,), ())
    )
    points = [[0.024, 0.053, -0.02], [0.045, 0.060, 0.0]]
    (u, v), (u_deck, v_deck) = see(Scene(), T_WORLD_REF, points).round().astype(int)
    assert lit[v, u] == unlit[v, u]
    assert lit[v_deck, u_deck] > 1.5 * unlit[v_deck, u_deck]


def test_a_stronger_lamp_adds_light_in_proportion() -> None:
    def under(strength: float) -> np.ndarray:
        lamps = (PointLight(position=(0.4, 0.5, 1.0), strength=strength),)
        return render_radiance(
            Scene(lighting=Lighting(lamps, ambient=0.0), image_size=128), T_WORLD_REF
        )

    np.testing.assert_allclose(under(0.06), 2 * under(0.03), rtol=1e-5, atol=1e-7)


def test_a_small_image_is_the_large_one_averaged_over_areas() -> None:
    small = render_radiance(Scene(image_size=64), T_WORLD_REF)
    large = render_radiance(Scene(image_size=512), T_WORLD_REF)
    averaged = large.reshape(64, 8, 64, 8).mean(axis=(1, 3))
    assert np.sqrt(np.mean((small - averaged) ** 2)) < 0.02
    assert abs(small.mean() - averaged.mean()) < 0.002


def test_a_camera_that_looks_at_the_sky_sees_black() -> None:
    up = rigid_transform(np.eye(3), [0.0, 0.0, 0.55])
    assert (render(Scene(image_size=16), up) == 0).all()


def test_images_repeat_bit_for_bit_and_noise_follows_the_generator() -> None:
    scene = Scene(image_size=32)
    first, again, other = (
        render(scene, T_WORLD_REF, np.random.default_rng(seed)) for seed in (5, 5, 6)
    )
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


def test_each_image_is_of_its_own_scene_and_pose_and_has_its_own_noise() -> None:
    plane, aside = Scene(part=TexturedPlane(), image_size=32), T_WORLD_REF.copy()
    aside[0, 3] += 0.02
    order = [(scene, T) for scene in (plane, replace(plane, image_size=48), plane)
             for T in (T_WORLD_REF, T_WORLD_REF, aside, T_WORLD_REF)]  # fmt: skip
    taking, rng = np.random.default_rng(3), np.random.default_rng(3)
    for scene, T in order:
        image = render(scene, T, taking)
        np.testing.assert_array_equal(image, scene.sensor.read_out(render_radiance(scene, T), rng))


def test_the_sensor_does_not_change_the_light() -> None:
    scene = Scene(image_size=32)
    noisy = replace(scene, sensor=Sensor(gain=2.0))
    np.testing.assert_array_equal(
        render_radiance(scene, T_WORLD_REF), render_radiance(noisy, T_WORLD_REF)
    )


@pytest.mark.parametrize("image_size", [15, 2049, 64.0])
def test_image_sizes_out_of_range_are_refused(image_size: int) -> None:
    with pytest.raises(InvalidInputError, match="image_size must be a whole number from 16 to"):
        Scene(image_size=image_size)


def test_a_lamp_that_takes_light_away_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="strength must be finite and not negative, got -1"):
        PointLight(position=(0, 0, 1), strength=-1)


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
    assert np.mean(np.abs(depth[row, column] - z) < 1e-3) > 0.25
    nearest_around = cv2.erode(depth, np.ones((3, 3)))[row, column]
    assert np.mean(nearest_around > z + 1e-3) < 0.005


@pytest.mark.parametrize("part", [TexturedPlane(), None])
def test_a_camera_that_looks_at_the_sky_sees_infinitely_far(part: TexturedPlane | None) -> None:
    up = rigid_transform(np.eye(3), [0.0, 0.0, 0.55])
    scene = Scene(image_size=16) if part is None else Scene(part, image_size=16)
    assert np.isposinf(render_depth(scene, up)).all()
