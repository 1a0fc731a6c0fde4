"""Matrices make images small and blurred as OpenCV does."""

import cv2
import numpy as np
import pytest

from servoscope.export.resizing import reduction
from servoscope.keyframe.levels import level_height, prepare


@pytest.mark.parametrize("shape", [(96, 128), (48, 64), (100, 133), (61, 47), (480, 640)])
@pytest.mark.parametrize("sigma", [0.0, 0.7, 3.2])
def test_images_are_prepared_as_for_the_alignment(shape, sigma, rng):
    image = rng.integers(0, 256, shape, dtype=np.uint8)
    width = min(32, shape[1])
    to = level_height(shape, width), width
    rows, columns = (reduction(a, b, sigma) for a, b in zip(shape, to, strict=True))
    made = rows @ image.astype(np.float32) @ columns.T
    np.testing.assert_allclose(made, prepare(image, width, sigma), atol=3e-4)


def test_other_shapes_are_shrunk_by_areas(rng):
    image = rng.integers(0, 256, (90, 70)).astype(np.float32)
    made = reduction(90, 32, 0.0) @ image @ reduction(70, 25, 0.0).T
    expected = cv2.resize(image, (25, 32), interpolation=cv2.INTER_AREA)
    np.testing.assert_allclose(made, expected, atol=2e-4)
