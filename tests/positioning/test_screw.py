"""A constant velocity, kept up, brings the displacement of its screw."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from servoscope.poses import inverse_transform, is_rigid, rigid_transform
from servoscope.positioning.screw import motion

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
