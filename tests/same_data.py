"""Data sets that are to be the same, bit for bit."""

import numpy as np

from servoscope.data.images import PoseImageSet


def assert_same(a: PoseImageSet, b: PoseImageSet) -> None:
    """Fail if images, poses, the reference or the source differ."""
    np.testing.assert_array_equal(a.images, b.images)
    np.testing.assert_array_equal(a.T_world_cam, b.T_world_cam)
    np.testing.assert_array_equal(a.reference_image, b.reference_image)
    assert a.source == b.source
