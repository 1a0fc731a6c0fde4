"""A textured plane is seen where a pinhole camera sees it, in the light that falls on it."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from servoscope.errors import InvalidInputError
from servoscope.poses import inverse_transform, poses_from_displacements, rigid_transform
from servoscope.scene.camera import Lens
from servoscope.scene.lighting import Lighting, PointLight
from servoscope.scene.render import render, render_radiance
from servoscope.scene.scene import T_WORLD_REF, Scene
from servoscope.scene.textured_plane import (
    ALBEDO_LIMITS,
    N_TEXELS,
    TEXEL,
    TexturedPlane,
    pyramid_of,
)

PINHOLE = Lens(distortion=(0.0, 0.0))
ONLY_AMBIENT = Lighting(lamps=(), ambient=1.0)
RANGES = np.array([0.025] * 3 + [np.radians(15)] * 3)


@pytest.fixture(scope="module")
def albedo() -> np.ndarray:
    return TexturedPlane().albedo()


def _poses(n: int, factor: float, seed: int = 4) -> np.ndarray:
    delta_p = np.random.default_rng(seed).uniform(-factor, factor, (n, 6)) * RANGES
    return poses_from_displacements(T_WORLD_REF, delta_p, 0.55)


@pytest.mark.parametrize("T_world_cam", [T_WORLD_REF, *_poses(1, 1.6)])
def test_the_plane_is_where_a_homography_puts_it(
    T_world_cam: np.ndarray, albedo: np.ndarray
) -> None:
    size = 256
    scene = Scene(TexturedPlane(), ONLY_AMBIENT, PINHOLE, image_size=size)
    T = inverse_transform(T_world_cam)
    texel_to_world = np.array([[TEXEL, 0, 0], [0, TEXEL, 0], [0, 0, 1]])
    texel_to_pixel = PINHOLE.camera_matrix(size) @ T[:3, [0, 1, 3]] @ texel_to_world
    middle = np.roll(albedo, (1024, 1024), (0, 1))
    middle = cv2.GaussianBlur(middle, (0, 0), 0.65)  # about a pixel's width, in texels
    shift = np.array([[1, 0, -1024], [0, 1, -1024], [0, 0, 1.0]])
    expected = cv2.warpPerspective(middle, texel_to_pixel @ shift, (size, size))
    seen = render_radiance(scene, T_world_cam)
    error = np.sqrt(np.mean((seen - expected) ** 2))
    moved = np.sqrt(np.mean((np.roll(seen, 1, axis=1) - expected) ** 2))
    assert error < 0.015
    assert error < 0.2 * moved


def test_the_light_on_the_plane_is_that_of_the_closed_form() -> None:
    lamps = (PointLight((0.3, 0.5, 0.9), 0.6), PointLight((-0.4, 0.1, 0.7), 0.2))
    lit = Scene(TexturedPlane(), Lighting(lamps, 0.3), PINHOLE, image_size=64)
    plain = replace(lit, lighting=ONLY_AMBIENT)
    K = PINHOLE.camera_matrix(64)
    column, row = np.meshgrid(np.arange(64.0), np.arange(64.0))
    x, y = 0.55 * (column - K[0, 2]) / K[0, 0], -0.55 * (row - K[1, 2]) / K[1, 1]
    light = np.full((64, 64), 0.3)
    for lamp in lamps:
        way = np.array(lamp.position) - np.stack([x, y, np.zeros_like(x)], axis=-1)
        light += lamp.strength * way[..., 2] / np.linalg.norm(way, axis=-1) ** 3
    ratio = render_radiance(lit, T_WORLD_REF) / render_radiance(plain, T_WORLD_REF)
    np.testing.assert_allclose(ratio, light, rtol=1e-4)


def test_the_lens_bends_the_plane_as_opencv_says() -> None:
    straight = Scene(TexturedPlane(), ONLY_AMBIENT, PINHOLE, image_size=256)
    bent = replace(straight, lens=Lens(distortion=(-0.3, 0.1)))
    K = PINHOLE.camera_matrix(256)
    distortion = np.array([-0.3, 0.1, 0.0, 0.0])
    undone = cv2.undistort(render_radiance(bent, T_WORLD_REF), K, distortion)
    inner = np.s_[20:-20, 20:-20]
    difference = (undone - render_radiance(straight, T_WORLD_REF))[inner]
    assert np.sqrt(np.mean(difference**2)) < 0.03


def test_it_fills_the_view_with_greys_short_of_black_and_white() -> None:
    scene = Scene(TexturedPlane())
    for pose in _poses(6, 1.6):
        image = render(scene, pose, np.random.default_rng(0))
        assert image.min() > 0
        assert image.max() < 250
        low, high = np.percentile(image, [5, 95])
        assert high - low > 100


def test_its_albedo_is_spread_over_the_range_and_repeats_nowhere_in_a_view(
    albedo: np.ndarray,
) -> None:
    low, high = ALBEDO_LIMITS
    assert low <= albedo.min() < albedo.max() <= high
    counts, _ = np.histogram(albedo, 10, ALBEDO_LIMITS)
    assert counts.min() > 0.05 * albedo.size
    spectrum = np.abs(np.fft.rfft2(albedo - albedo.mean())) ** 2
    correlation = np.fft.irfft2(spectrum) / spectrum[:, 1:-1].sum() / 2 * albedo.size
    correlation /= correlation[0, 0]
    lag = np.hypot(*np.meshgrid(*2 * [N_TEXELS * np.fft.fftfreq(N_TEXELS)]))
    assert correlation[lag * TEXEL > 0.15].max() < 0.25


def test_a_small_image_is_the_large_one_averaged_over_areas() -> None:
    small, large = (
        render_radiance(Scene(TexturedPlane(), image_size=size), T_WORLD_REF) for size in (64, 512)
    )
    averaged = large.reshape(64, 8, 64, 8).mean(axis=(1, 3))
    assert np.sqrt(np.mean((small - averaged) ** 2)) < 0.02


def test_coarser_copies_keep_the_place_of_the_texture() -> None:
    texels, starts = pyramid_of(TexturedPlane())
    fine = texels[: starts[1]].reshape(N_TEXELS, N_TEXELS).astype(float)
    phase = np.fft.rfft2(fine)[0, 1]
    for k in range(1, 6):
        n = N_TEXELS >> k
        copy = texels[starts[k] : starts[k + 1]].reshape(n, n).astype(float)
        assert np.angle(np.fft.rfft2(copy)[0, 1] / phase) == pytest.approx(0, abs=1e-2)


def test_a_camera_that_does_not_look_at_the_plane_sees_black() -> None:
    scene = Scene(TexturedPlane(), image_size=16)
    for pose in (
        rigid_transform(np.eye(3), [0, 0, 0.55]),
        rigid_transform(np.diag([1.0, -1.0, -1.0]), [0, 0, -0.1]),
    ):
        assert (render_radiance(scene, pose) == 0).all()


def test_images_repeat_bit_for_bit_and_variants_differ(albedo: np.ndarray) -> None:
    np.testing.assert_array_equal(albedo, TexturedPlane().albedo())
    a, b = (
        render(Scene(TexturedPlane(variant), image_size=64), T_WORLD_REF, np.random.default_rng(1))
        for variant in (0, 1)
    )
    assert abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < 0.4


@pytest.mark.parametrize("variant", [-1, 0.5, True, "0"])
def test_a_variant_that_is_no_count_is_refused(variant: object) -> None:
    with pytest.raises(InvalidInputError, match="variant must be a whole number from 0"):
        TexturedPlane(variant=variant)


def test_what_is_repainted_is_that_share_of_the_surface_and_the_rest_stays(
    albedo: np.ndarray,
) -> None:
    before, after = albedo, TexturedPlane(repainted=0.2).albedo()
    same = before == after
    assert same.mean() == pytest.approx(0.8, abs=0.01)
    assert abs(np.corrcoef(before[~same], after[~same])[0, 1]) < 0.2


@pytest.mark.parametrize("share", [-0.1, 1.1, float("nan")])
def test_a_share_that_is_none_is_refused(share: float) -> None:
    with pytest.raises(InvalidInputError, match="repainted must be from 0 to 1"):
        TexturedPlane(repainted=share)


@pytest.mark.parametrize("image_size", [16, 24])
def test_what_is_seen_nearly_edge_on_has_the_greys_of_the_plane(image_size):
    scene = Scene(TexturedPlane(), ONLY_AMBIENT, PINHOLE, image_size=image_size)
    low, high = ALBEDO_LIMITS
    for tilt in np.radians(np.arange(60, 80)):
        T = T_WORLD_REF @ rigid_transform(Rotation.from_euler("x", tilt).as_matrix(), np.zeros(3))
        seen = render_radiance(scene, T)
        assert (seen > 0).any()
        assert (((low <= seen) & (seen <= high)) | (seen == 0)).all()
