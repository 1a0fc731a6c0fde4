import numpy as np
import pytest

from servoscope.errors import InvalidInputError
from servoscope.keyframe.camera import CameraModel
from servoscope.keyframe.motion import (
    adjoint,
    conjugate,
    displacement_by_twist,
    exponential,
    logarithm,
)
from servoscope.keyframe.warping import (
    CAMERA,
    LIGHT,
    MOTION,
    N_ALIGNED,
    N_COLUMNS,
    RELIEF,
    UNSEEN,
    linearise,
    sample,
)
from servoscope.poses import displacements_from_poses

HEIGHT, WIDTH, N = 150, 240, 60
LENS = CameraModel(0.8, 0.02, -0.01, -0.13, 0.05)
T = exponential([0.01, 0.02, -0.03, 0.05, 0.02, 0.1])
EVEN = np.array([1.0, 0.1, 0.1, -0.2])


def smooth_image(x, y):
    """Grey levels that bend so slowly that straight lines between pixels do."""
    return 100 + 60 * x - 40 * y + 30 * x * x - 20 * x * y + 25 * y * y


def pixels(height, width):
    x = (np.arange(width) + 0.5) / width - 0.5
    y = ((np.arange(height) + 0.5) / height - 0.5) * height / width
    return np.meshgrid(x, y)


IMAGE = smooth_image(*pixels(HEIGHT, WIDTH)).astype(np.float32)
RNG = np.random.default_rng(0)
POINTS = RNG.uniform(-0.3, 0.3, (N, 2)) * [1, HEIGHT / WIDTH]
DEPTH = RNG.uniform(1, 2, N).astype(np.float32)
GREY = RNG.uniform(50, 100, N).astype(np.float32)
SLOPES = RNG.normal(size=(N, 2)).astype(np.float32)


def evaluated(step, depth_step=0.0, n_columns=N_COLUMNS):
    """Residuals after a step of all columns, derivatives, and the derivative by depth."""
    lens = LENS.moved(step[CAMERA])
    rays, by_camera = lens.rays(POINTS)
    gain, offset, *rise = EVEN + step[LIGHT]
    gains = (gain + POINTS @ rise).astype(np.float32)
    factor, right, down = step[RELIEF]
    depth = DEPTH * (1 + factor) + POINTS @ [right, down] + depth_step
    jacobian = np.empty((N, n_columns), np.float32)
    by_depth, residuals = np.empty(N, np.float32), np.empty(N, np.float32)
    n_seen = linearise(
        IMAGE, exponential(step[MOTION]) @ T, lens.values, HEIGHT / WIDTH,
        POINTS.astype(np.float32), rays.astype(np.float32), by_camera.astype(np.float32),
        depth.astype(np.float32), GREY, gains, np.full(N, offset, np.float32), SLOPES, False,
        jacobian, by_depth, residuals,
    )  # fmt: skip
    assert n_seen == N
    return residuals.astype(float), jacobian, by_depth


@pytest.mark.parametrize("column", range(N_COLUMNS))
def test_derivatives_are_those_of_finite_differences(column):
    h = 2e-3
    step = np.zeros(N_COLUMNS)
    step[column] = h
    slope = (evaluated(step)[0] - evaluated(-step)[0]) / (2 * h)
    found = evaluated(np.zeros(N_COLUMNS))[1][:, column]
    np.testing.assert_allclose(found, slope, atol=0.01 * np.abs(slope).max() + 0.02)


def test_derivative_by_inverse_depth_is_that_of_finite_differences():
    none, h = np.zeros(N_COLUMNS), 5e-3
    slope = (evaluated(none, h)[0] - evaluated(none, -h)[0]) / (2 * h)
    found = evaluated(none)[2]
    np.testing.assert_allclose(found, slope, atol=0.02 * np.abs(slope).max())


def test_an_alignment_takes_the_first_columns():
    none = np.zeros(N_COLUMNS)
    narrow, wide = evaluated(none, n_columns=N_ALIGNED)[1], evaluated(none)[1]
    np.testing.assert_array_equal(narrow, wide[:, :N_ALIGNED])


def test_derivatives_carried_from_the_reference_are_those_of_the_image_of_a_plane():
    """A plane at rest: what the reference shows, carried, is what the image shows."""
    x, y = pixels(HEIGHT, WIDTH)
    points = np.stack([x, y], -1).reshape(-1, 2)
    rays, by_camera = (a.astype(np.float32) for a in LENS.rays(points))
    plane = np.full(len(points), 1e-3, np.float32)  # far away: the warp is a rotation
    turn = exponential([0, 0, 0, 0.05, -0.04, 0.2])
    seen = np.empty(len(points), np.float32)
    sample(IMAGE, turn, LENS.values, HEIGHT / WIDTH, rays, plane, seen)
    reference = np.where(seen > UNSEEN, seen, np.nan).reshape(HEIGHT, WIDTH)
    down, right = np.gradient(reference)
    slopes = np.stack([right * WIDTH, down * WIDTH], -1).reshape(-1, 2)
    ok = np.isfinite(slopes).all(axis=1)
    both = []
    for carries in (False, True):
        jacobian = np.empty((ok.sum(), N_ALIGNED), np.float32)
        out = np.empty(ok.sum(), np.float32), np.empty(ok.sum(), np.float32)
        linearise(
            IMAGE, turn, LENS.values, HEIGHT / WIDTH, points[ok].astype(np.float32), rays[ok],
            by_camera[ok], plane[ok], seen[ok], np.ones(ok.sum(), np.float32),
            np.zeros(ok.sum(), np.float32), slopes[ok].astype(np.float32), carries, jacobian, *out,
        )  # fmt: skip
        both.append(jacobian[:, 3:6])
    np.testing.assert_allclose(both[1], both[0], atol=0.03 * np.abs(both[0]).max())


def test_grey_levels_between_pixels_are_exact_for_parabolas():
    """Cubic convolution with a = -1/2 reproduces polynomials of the second degree (Keys, 1981)."""
    rays = LENS.rays(POINTS)[0].astype(np.float32)
    turn = exponential([0, 0, 0, 0.01, -0.02, 0.1])
    far = np.full(N, 1e-6, np.float32)
    residuals, jacobian = np.empty(N, np.float32), np.empty((N, N_ALIGNED), np.float32)
    one, none = np.ones(N, np.float32), np.zeros(N, np.float32)
    linearise(
        IMAGE, turn, LENS.values, HEIGHT / WIDTH, POINTS.astype(np.float32), rays,
        LENS.rays(POINTS)[1].astype(np.float32), far, none, one, none, SLOPES, True,
        jacobian, np.empty_like(none), residuals,
    )  # fmt: skip
    p = np.column_stack([rays, np.ones(N)]) @ turn[:3, :3].T
    p = p[:, :2] / p[:, 2:]
    r2 = (p**2).sum(axis=1, keepdims=True)
    x, y = (0.8 * p * (1 - 0.13 * r2 + 0.05 * r2**2) + [0.02, -0.01]).T
    np.testing.assert_allclose(residuals, smooth_image(x, y), atol=2e-4)


def test_points_behind_the_camera_beside_the_image_or_folded_over_are_not_seen():
    rays = np.array([[0, 0], [3.0, 0], [0.1, 0.1]], np.float32)
    grey = np.empty(3, np.float32)
    near = np.ones(3, np.float32)
    camera = CameraModel(0.8).values
    sample(IMAGE, np.eye(4), camera, HEIGHT / WIDTH, rays, near, grey)
    assert (grey > UNSEEN).tolist() == [True, False, True]
    behind = exponential([0, 0, -1.2, 0, 0, 0])
    sample(IMAGE, behind, camera, HEIGHT / WIDTH, rays, near, grey)
    assert (grey == UNSEEN).all()
    folded = CameraModel(0.1, k1=-0.2).values
    sample(IMAGE, np.eye(4), folded, HEIGHT / WIDTH, rays, near, grey)
    assert (grey > UNSEEN).tolist() == [True, False, True]


def test_what_is_saturated_and_expected_to_be_brighter_tells_nothing():
    white = np.full((HEIGHT, WIDTH), 255, np.float32)
    rays, by_camera = (a.astype(np.float32) for a in LENS.rays(POINTS))
    jacobian = np.ones((N, N_ALIGNED), np.float32)
    by_depth, residuals = np.ones(N, np.float32), np.ones(N, np.float32)
    for light, silent in ((4.0, GREY * 4 > 255), (0.5, np.zeros(N, bool))):
        linearise(
            white, np.eye(4), LENS.values, HEIGHT / WIDTH, POINTS.astype(np.float32), rays,
            by_camera, DEPTH, GREY, np.full(N, light, np.float32), 0 * GREY, SLOPES, False,
            jacobian, by_depth, residuals,
        )  # fmt: skip
        np.testing.assert_array_equal(residuals == 0, silent)


def test_rays_are_where_the_camera_sees_them_and_their_derivatives_are_right():
    rays, by_camera = LENS.rays(POINTS)
    r2 = (rays**2).sum(axis=1, keepdims=True)
    seen = 0.8 * rays * (1 - 0.13 * r2 + 0.05 * r2**2) + [0.02, -0.01]
    np.testing.assert_allclose(seen, POINTS, atol=1e-12)
    for j, h in enumerate(1e-5 * np.eye(5)):
        slope = (LENS.moved(h).rays(POINTS)[0] - LENS.moved(-h).rays(POINTS)[0]) / 2e-5
        np.testing.assert_allclose(by_camera[:, :, j], slope, atol=1e-6)


def test_a_camera_in_pixels_sees_the_middle_of_the_first_pixel_where_opencv_does():
    camera = CameraModel.from_pixels(500.0, (310.0, 250.0), width=640, height=480)
    first = np.array([[0.5 / 640 - 0.5, (0.5 - 240) / 640]])
    np.testing.assert_allclose(camera.rays(first)[0][0], [-310 / 500, -250 / 500], atol=1e-12)


@pytest.mark.parametrize("values", [(0.0,), (-1.0,), (np.nan,), (1.0, np.inf)])
def test_an_impossible_camera_is_refused(values):
    with pytest.raises(InvalidInputError, match="positive focal length"):
        CameraModel(*values)


def test_twists_and_motions_agree():
    twist = RNG.normal(size=(5, 6)) * 0.3
    np.testing.assert_allclose(logarithm(exponential(twist)), twist, atol=1e-12)
    X, small = exponential(twist[0]), 1e-6 * twist[1]
    np.testing.assert_allclose(
        X @ exponential(small), exponential(adjoint(X) @ small) @ X, atol=1e-11
    )
    np.testing.assert_allclose(conjugate(X, np.eye(4)), np.eye(4), atol=1e-12)


def test_the_six_numbers_change_with_a_twist_as_finite_differences_do():
    D, h = exponential([0.01, 0.02, 0.03, 0.3, -0.2, 0.4]), 1e-6
    found = displacement_by_twist(D)
    for j, step in enumerate(h * np.eye(6)):
        ends = np.stack([D @ exponential(step), D @ exponential(-step)])
        high, low = displacements_from_poses(np.eye(4), ends, 0.0)
        np.testing.assert_allclose(found[:, j], (high - low) / (2 * h), atol=1e-6)
