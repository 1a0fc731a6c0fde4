"""The lens maps points to pixels as OpenCV does, and back."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from servoscope.errors import InvalidInputError
from servoscope.scene.lens import Lens

fractions = st.floats(0.0, 1.0)


@given(fractions, fractions, st.floats(-0.15, 0.3), st.floats(0.0, 0.1))
def test_a_point_on_the_ray_of_a_pixel_is_seen_there(
    u: float, v: float, k1: float, k2: float
) -> None:
    lens = Lens(distortion=(k1, k2))
    pixel = np.array([u, v]) * 256 - 0.5
    seen = lens.project(0.7 * lens.rays(pixel, 256), 256)
    np.testing.assert_allclose(seen, pixel, atol=1e-9)


@given(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(0.3, 2.0))
def test_projection_is_that_of_opencv(x: float, y: float, z: float) -> None:
    lens = Lens()
    K, still = lens.camera_matrix(256), np.zeros(3)
    point = np.array([x * z, y * z, z])
    expected, _ = cv2.projectPoints(point, still, still, K, np.array([*lens.distortion, 0, 0]))
    np.testing.assert_allclose(lens.project(point, 256), expected.ravel(), atol=1e-8)


def test_images_of_every_size_show_the_same_view() -> None:
    lens = Lens()
    small, large = lens.rays([-0.5, 31.5], 32), lens.rays([-0.5, 511.5], 512)
    np.testing.assert_allclose(small, large, atol=1e-12)


def test_a_lens_that_folds_the_image_over_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="folds the image over"):
        Lens(distortion=(-2.0, 0.0))


@pytest.mark.parametrize("focal_length", [0.0, -1.0])
def test_a_focal_length_that_is_not_positive_is_refused(focal_length: float) -> None:
    with pytest.raises(InvalidInputError, match="focal_length must be positive"):
        Lens(focal_length=focal_length)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("focal_length", np.inf),
        ("focal_length", np.nan),
        ("principal_point", (np.nan, 0.5)),
        ("distortion", (0.0, np.nan)),
    ],
)
def test_numbers_that_are_not_finite_are_refused(name: str, value: object) -> None:
    with pytest.raises(InvalidInputError, match=f"{name} must be finite, got"):
        Lens(**{name: value})
