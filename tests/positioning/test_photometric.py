"""Photometric servoing: its law, what it believes, and where it is known to fail."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from servoscope.errors import InvalidInputError
from servoscope.poses import (
    inverse_transform,
    is_rigid,
    pose_error,
    poses_from_displacements,
    rigid_transform,
)
from servoscope.positioning.photometric import (
    SMOOTHING_PX,
    PhotometricEstimate,
    PhotometricLaw,
    PhotometricServoing,
    luminance_interaction,
    motion,
)
from servoscope.scene.camera import Lens, Sensor
from servoscope.scene.lighting import Lighting
from servoscope.scene.render import render, render_depth, render_radiance
from servoscope.scene.scene import T_WORLD_REF, Scene
from servoscope.scene.textured_plane import TexturedPlane

PIVOT = 0.55
RANGES = np.array([0.025] * 3 + [np.radians(15)] * 3)
NARROW = Lens(focal_length=1.375, principal_point=(0.5, 0.5), distortion=(0.0, 0.0))


def _servoing(scene: Scene, depth: ArrayLike = PIVOT) -> PhotometricServoing:
    K = scene.lens.camera_matrix(scene.image_size)
    reference = render(scene, T_WORLD_REF)
    return PhotometricServoing(reference, K[0, 0], (K[0, 2], K[1, 2]), depth, RANGES, PIVOT)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene(TexturedPlane(), lens=NARROW, image_size=128)


@pytest.fixture(scope="module")
def servoing(scene: Scene) -> PhotometricServoing:
    return _servoing(scene)


@pytest.fixture(scope="module")
def image(scene: Scene) -> np.ndarray:
    (pose,) = poses_from_displacements(T_WORLD_REF, 0.3 * RANGES[None], PIVOT)
    return render(scene, pose)


def test_a_step_is_that_of_the_published_law(
    scene: Scene, servoing: PhotometricServoing, image: np.ndarray
) -> None:
    K = scene.lens.camera_matrix(128)
    inner = np.s_[10:-10, 10:-10]
    L = luminance_interaction(servoing.reference_image, PIVOT, K[0, 0], (K[0, 2], K[1, 2]))
    L = np.stack([row[inner].ravel() for row in L], axis=1)
    error = (image.astype(float) - servoing.reference_image)[inner].ravel()
    H = L.T @ L
    for moves, mu in ((0, 0.01), (90, 0.01), (91, 0.0001)):
        before = None if moves == 0 else replace(servoing.estimate(image, None), moves=moves - 1)
        estimate = servoing.estimate(image, before)
        velocity = -30 * np.linalg.inv(mu * np.diag(np.diag(H)) + H) @ L.T @ error
        assert estimate.moves == moves
        move = inverse_transform(estimate.step)
        np.testing.assert_allclose(move, motion(0.04 * velocity), atol=1e-6)
        expected = motion(np.linalg.lstsq(L, error, rcond=None)[0])
        np.testing.assert_allclose(estimate.displacement, expected, atol=1e-6)
        assert estimate.squared_difference == pytest.approx(np.mean(error**2))


@pytest.mark.parametrize("axis", range(6))
def test_a_small_displacement_is_believed_as_it_is(axis: int) -> None:
    soft = Scene(TexturedPlane(), lens=NARROW, sensor=Sensor(blur=2.5 / 256))
    D = motion(np.array([8e-4] * 3 + [1.5e-3] * 3)[axis] * np.eye(6)[axis])
    believed = _servoing(soft).estimate(render(soft, T_WORLD_REF @ D), None).displacement
    assert np.abs(believed - D).max() < 0.3 * np.abs(D - np.eye(4)).max()


def test_it_is_content_at_the_reference_alone(
    servoing: PhotometricServoing, image: np.ndarray
) -> None:
    there = servoing.estimate(servoing.reference_image, None)
    assert there.converged
    np.testing.assert_allclose(there.displacement, np.eye(4), atol=1e-12)
    assert not servoing.estimate(image, None).converged


def test_an_estimate_hangs_on_nothing_but_image_and_count(
    servoing: PhotometricServoing, image: np.ndarray
) -> None:
    first = servoing.estimate(image, None)
    servoing.estimate(servoing.reference_image, first)
    again = servoing.estimate(image.copy(), None)
    np.testing.assert_array_equal(first.step, again.step)
    assert math.isnan(first.novelty)
    assert np.isnan(first.std).all()


def test_a_map_of_depths_is_used_pixel_by_pixel(scene: Scene) -> None:
    depth = np.full((128, 128), np.inf)
    depth[:, 64:] = PIVOT
    L = _servoing(scene, depth).interaction_
    flat = _servoing(scene).interaction_
    assert (L[:3, :, :54] == 0).all()
    np.testing.assert_array_equal(L[:, :, 54:], flat[:, :, 54:])
    np.testing.assert_array_equal(L[3:], flat[3:])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"reference_image": np.zeros((64, 64))}, "reference_image must be uint8"),
        ({"reference_image": np.zeros((20, 64), np.uint8)}, "at least 21 pixels each way"),
        ({"reference_image": np.full((64, 64), 9, np.uint8)}, "does not inform all six dofs"),
        ({"focal_px": 0.0}, "focal_px must be positive and finite, got 0.0"),
        ({"focal_px": math.nan}, "focal_px must be positive and finite, got nan"),
        ({"principal_px": (1.0,)}, "principal_px must be 2 finite numbers"),
        ({"distortion": (0.0, math.inf)}, "distortion must be 2 finite numbers"),
        ({"depth": np.ones((3, 3))}, r"depth must be a number or of the image's shape \(64, 64\)"),
        ({"depth": -1.0}, "depth must be positive everywhere"),
        ({"depth": math.nan}, "depth must be positive everywhere"),
        ({"depth": math.inf}, "does not inform all six dofs"),
        ({"reach": np.ones(3)}, "reach must be 6 finite numbers"),
        ({"pivot": math.nan}, "pivot must be finite"),
    ],
)
def test_bad_input_is_refused_in_one_line(change: dict[str, object], message: str) -> None:
    noise = np.random.default_rng(0).integers(0, 255, (64, 64), dtype=np.uint8)
    good = {
        "reference_image": noise,
        "focal_px": 90.0,
        "principal_px": (32.0, 32.0),
        "depth": PIVOT,
        "reach": RANGES,
        "pivot": PIVOT,
    }
    with pytest.raises(InvalidInputError, match=message) as raised:
        PhotometricServoing(**{**good, **change})
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"gain": math.nan}, "gain must be finite and at least 0, got nan"),
        ({"damping": -0.1}, "damping must be finite and at least 0"),
        ({"border": 2}, "border must be finite and at least 3, got 2"),
    ],
)
def test_laws_that_cannot_be_are_refused(change: dict[str, float], message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        PhotometricLaw(**change)


def _ends_mm(
    servoing: PhotometricServoing, scene: Scene, n_starts: int, n_moves: int, gain: float = 1.0
) -> np.ndarray:
    delta_p = np.random.default_rng(7).uniform(-1, 1, (n_starts, 6)) * RANGES
    ends = []
    for pose in poses_from_displacements(T_WORLD_REF, delta_p, PIVOT):
        previous: PhotometricEstimate | None = None
        for _ in range(n_moves):
            image = (gain * render(scene, pose)).astype(np.uint8)
            previous = servoing.estimate(image, previous)
            if previous.converged:
                break
            pose = pose @ inverse_transform(previous.step)
            if pose_error(T_WORLD_REF, pose)[0] > 2:
                break
        ends.append(1e3 * float(pose_error(T_WORLD_REF, pose)[0]))
    return np.array(ends)


@pytest.mark.slow
def test_it_arrives_from_the_whole_range_in_about_a_hundred_moves(scene: Scene) -> None:
    large = replace(scene, image_size=256)
    assert (_ends_mm(_servoing(large), large, n_starts=4, n_moves=120) < 1.0).sum() >= 3


@pytest.mark.slow
def test_a_darker_camera_or_a_wrong_depth_leads_it_astray(scene: Scene) -> None:
    large = replace(scene, image_size=256)
    assert (_ends_mm(_servoing(large), large, 2, 100, gain=0.8) > 1.0).all()
    assert (_ends_mm(_servoing(large, depth=1.5 * PIVOT), large, 2, 100) > 1.0).all()


OBLIQUE = T_WORLD_REF @ motion([0.1, -0.05, 0.02, 0.15, -0.1, 0.3])


def _soft(scene: Scene, T_world_cam: np.ndarray) -> np.ndarray:
    """Without detail as fine as the pixels, whose slopes no sum over pixels tells."""
    return cv2.GaussianBlur(render_radiance(scene, T_world_cam), (0, 0), 3.0).astype(float)


@pytest.mark.parametrize("distortion", [(0.0, 0.0), (-0.3, 0.1)])
@pytest.mark.parametrize("axis", range(6))
def test_it_is_the_difference_of_images_of_a_plane(
    axis: int, distortion: tuple[float, float]
) -> None:
    scene = Scene(
        TexturedPlane(),
        Lighting(lamps=(), ambient=1.0),
        Lens(principal_point=(0.45, 0.56), distortion=distortion),
        image_size=256,
    )
    K = scene.lens.camera_matrix(256)
    depth = render_depth(scene, OBLIQUE)
    L = luminance_interaction(_soft(scene, OBLIQUE), depth, K[0, 0], (K[0, 2], K[1, 2]), distortion)
    screw = 1e-3 * np.eye(6)[axis]
    ahead, behind = (_soft(scene, OBLIQUE @ motion(s)) for s in (screw, -screw))
    inner = np.s_[15:-15, 15:-15]
    expected = cv2.GaussianBlur((ahead - behind) / 2e-3, (0, 0), SMOOTHING_PX)[inner].ravel()
    found = L[axis][inner].ravel()
    assert np.corrcoef(found, expected)[0, 1] > 0.99
    assert found @ expected / (expected @ expected) == pytest.approx(1, abs=0.025)


def test_what_lies_infinitely_far_only_turns() -> None:
    image = np.random.default_rng(0).uniform(0, 255, (20, 20))
    near, far = (luminance_interaction(image, z, 50.0, (9.5, 9.5)) for z in (1.0, np.inf))
    assert (far[:3] == 0).all()
    np.testing.assert_array_equal(far[3:], near[3:])


SCREWS = arrays(float, 6, elements=st.floats(-3, 3))


@given(SCREWS)
def test_it_is_rigid_and_turns_by_the_rotation_vector(screw: np.ndarray) -> None:
    T = motion(screw)
    assert is_rigid(T, 1e-9)
    expected = Rotation.from_rotvec(screw[3:]).as_matrix()
    np.testing.assert_allclose(T[:3, :3], expected, atol=1e-9)


@given(SCREWS)
def test_the_way_back_is_the_opposite_screw(screw: np.ndarray) -> None:
    np.testing.assert_allclose(motion(-screw), inverse_transform(motion(screw)), atol=1e-9)


def test_it_is_the_sum_of_many_small_motions() -> None:
    screw, n = np.array([0.3, -0.2, 0.5, 0.4, 0.9, -0.6]), 20_000
    small = rigid_transform(Rotation.from_rotvec(screw[3:] / n).as_matrix(), screw[:3] / n)
    np.testing.assert_allclose(motion(screw), np.linalg.matrix_power(small, n), atol=1e-4)
