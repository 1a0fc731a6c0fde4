"""Grey levels where points are seen, also far beside the image."""

import cv2
import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from servoscope.keyframe import CameraModel
from servoscope.rehearsal.true_view import sample_at

RAMP = np.arange(6.0)[None].repeat(4, axis=0)


def sample(*point: float) -> float:
    points = np.array([[point]], dtype=float)
    return float(sample_at(RAMP, CameraModel(1.0), points, cv2.BORDER_REFLECT)[0, 0])


@pytest.mark.parametrize(("column", "grey"), [(2.0, 2.0), (-2.0, 1.0), (7.0, 4.0)])
def test_the_image_goes_on_mirrored_at_its_edges(column, grey):
    assert sample((column + 0.5) / 6 - 0.5, 0.0, 1.0) == pytest.approx(grey, abs=1e-5)


def test_between_pixels_is_what_is_interpolated_at_the_nearest_32nd_of_one(rng):
    """As OpenCV 4 rounds; OpenCV 5 does not."""
    image = rng.uniform(0, 255, (48, 64))
    column, row = rng.uniform(1, 62, 500), rng.uniform(1, 46, 500)
    points = np.c_[(column + 0.5) / 64 - 0.5, (row + 0.5) / 64 - 0.375, np.ones(500)]
    seen = sample_at(image, CameraModel(1.0), points[None], cv2.BORDER_REFLECT)[0]
    exact = map_coordinates(image, [row, column], order=1)
    i, j = row.astype(int), column.astype(int)
    around = np.stack([image[i + a, j + b] for a in (0, 1) for b in (0, 1)])
    assert (np.abs(seen - exact) <= np.ptp(around, axis=0) / 32 + 1e-3).all()
    assert np.ptp(seen) > 200


@pytest.mark.parametrize("far", [5e3, 1e12, 1e100])
def test_points_farther_off_are_seen_one_image_beside_the_edge(far):
    assert sample(far, 0.0, 1.0) == 0.0
    assert sample(-far, 0.0, 1.0) == 5.0
    assert 0.0 <= sample(np.nan, far, 1.0) <= 5.0
