"""The limit of a view, against images of the simulated cell, and with noise in the reference."""

import cv2
import numpy as np
import pytest

from servoscope import CameraModel, Keyframe
from servoscope.poses import poses_from_displacements
from servoscope.scene.camera import Sensor
from servoscope.scene.cylinder_head import CylinderHead
from servoscope.scene.render import render, render_depth, render_radiance
from servoscope.scene.scene import T_WORLD_REF, Scene
from servoscope.scene.textured_plane import TexturedPlane

PIVOT, SIZE = 0.55, 256
STEPS = np.array([1e-3] * 3 + [np.radians(0.1)] * 3)
"""[m] and [rad]."""


def known_keyframe(scene: Scene) -> Keyframe:
    """The keyframe of a scene whose lens and depth are known."""
    lens, reference = scene.lens, render(scene, T_WORLD_REF)
    cx, cy = np.array(lens.principal_point) - 0.5
    camera = CameraModel(lens.focal_length, cx, cy, *lens.distortion)
    depth = render_depth(scene, T_WORLD_REF)
    return Keyframe(
        reference, camera, np.eye(4), 1 / depth, np.ones_like(depth), np.eye(4)[None],
        np.zeros((20, 20)), np.zeros(6), pivot=PIVOT, residual=1.0, noise=1.0,
    )  # fmt: skip


def rendered_jacobian(scene: Scene, steps: np.ndarray) -> np.ndarray:
    """Central differences of grey levels by the six dofs, gain and offset, (n, 8)."""

    def grey(delta_p: np.ndarray) -> np.ndarray:
        pose = poses_from_displacements(T_WORLD_REF, delta_p, PIVOT)
        light = cv2.GaussianBlur(render_radiance(scene, pose), (0, 0), scene.sensor.blur * SIZE)
        return 255 * scene.sensor.exposure * light.astype(float).ravel()

    columns = [(grey(s) - grey(-s)) / (2 * s.max()) for s in np.diag(steps)]
    return np.stack([*columns, grey(np.zeros(6)), np.ones(SIZE**2)], axis=1)


@pytest.mark.parametrize(
    ("part", "step", "most", "alike"),
    [
        pytest.param(TexturedPlane(), 0.25, 1.35, 0.8, id="plane"),
        pytest.param(CylinderHead(), 1.0, 2.3, 0.2, id="head", marks=pytest.mark.slow),
    ],
)
def test_limit_and_its_pixels_are_those_of_rendered_images(part, step, most, alike):
    # The head's outlines, which hide what lies behind them, inform more than a keyframe knows.
    scene = Scene(part=part, image_size=SIZE, sensor=Sensor(vignetting=0.0))
    J = rendered_jacobian(scene, step * STEPS)
    unit = 1 / np.linalg.norm(J, axis=0)
    response = np.linalg.pinv(J * unit)[:6] * unit[:6, None]
    limit = known_keyframe(scene).limit(2.0)
    ratio = limit.std / (2.0 * np.linalg.norm(response, axis=1))
    assert (ratio > 0.9).all()
    assert (ratio < most).all()
    shares = (response**2).reshape(6, SIZE, SIZE) / (response**2).sum(axis=1)[:, None, None]
    for true, found in zip(shares, limit.shares, strict=True):
        a, b = (cv2.GaussianBlur(x.astype(float), (0, 0), 6).ravel() for x in (true, found))
        assert np.corrcoef(a, b)[0, 1] > alike


def plate(image: np.ndarray) -> Keyframe:
    """The keyframe of a flat part across the view, half a metre away."""
    flat = np.full((24, 32), 2.0, np.float32)
    return Keyframe(
        image, CameraModel(1.2), np.eye(4), flat, np.ones_like(flat), np.eye(4)[None],
        np.zeros((20, 20)), np.zeros(6), pivot=0.5, residual=1.0, noise=1.0,
    )  # fmt: skip


def noisy(grey: np.ndarray, sigma: float) -> np.ndarray:
    """An image with noise of its own."""
    noise = np.random.default_rng(1).normal(0, sigma, grey.shape)
    return np.clip(np.rint(grey + noise), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("blur", [2.0, 6.0, 16.0])
def test_noise_of_the_reference_is_not_taken_for_detail(blur):
    grey = cv2.GaussianBlur(np.random.default_rng(0).normal(size=(240, 320)), (0, 0), blur)
    grey = cv2.normalize(grey, None, 20, 235, cv2.NORM_MINMAX)
    clean = plate(noisy(grey, 0.0)).limit(3.0)
    for sigma in (1.0, 3.0):
        limit = plate(noisy(grey, sigma)).limit(3.0)
        np.testing.assert_allclose(limit.std, clean.std, rtol=0.1)
        np.testing.assert_allclose(limit.shares.sum(axis=(1, 2)), 1, rtol=1e-4)


@pytest.mark.parametrize("sigma", [1.0, 3.0, 20.0])
def test_nothing_is_read_of_noise_alone(sigma):
    limit = plate(noisy(np.full((240, 320), 128.0), sigma)).limit(3.0)
    assert (limit.std[:3] > 0.05).all()  # [m]
    assert (limit.std[3:] > 0.5).all()  # [rad]
    assert np.isfinite(limit.shares).all()


def test_what_an_edge_does_not_show_is_not_read_of_its_noise():
    step = np.where(np.arange(320) < 160, 60.0, 190.0) * np.ones((240, 1))
    std = plate(noisy(cv2.GaussianBlur(step, (0, 0), 2), 2.0)).limit(3.0).std
    assert std[1] > 1e3 * 3.0 / np.sqrt(240) / 32 * 0.5 / 384  # sigma / (slope * flow)


def test_a_wide_image_has_the_limit_of_its_pixels():
    grey = cv2.GaussianBlur(np.random.default_rng(0).normal(size=(96, 1024)), (0, 0), 8)
    grey = cv2.normalize(grey, None, 20, 235, cv2.NORM_MINMAX)
    wide = np.hstack([grey, grey[:, ::-1]])
    halved = cv2.resize(wide, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    limit, small = plate(noisy(wide, 0)).limit(2.0), plate(noisy(halved, 0)).limit(1.0)
    np.testing.assert_allclose(limit.std, small.std, rtol=0.05)
    assert limit.shares.shape == (6, 48, 1024)
