"""Scale, weights and steps of robust residuals."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from servoscope.keyframe.motion import exponential
from servoscope.keyframe.robust import BEND, curvature_ratio, robust_scale, robust_weights
from servoscope.keyframe.warping import UNSEEN
from servoscope.poses import rotation_angle

SCALE = 2.0


def _weights(residuals):
    weights = np.empty_like(residuals)
    robust_weights(residuals, SCALE, weights)
    return weights


@given(arrays(float, st.integers(1, 30), elements=st.floats(-200, 200)))
def test_the_scale_is_that_of_the_median_residual(residuals):
    expected = max(0.5, 1.4826 * np.median(np.abs(residuals)))
    assert robust_scale(residuals, 0.5) == pytest.approx(expected, rel=1e-15)


def test_the_curvature_ratio_is_the_derivative_of_the_gradient_over_the_weights(rng):
    residuals, step = rng.normal(0, 3, 500), 1e-5
    slopes = [(_weights(r) * r).sum() for r in (residuals + step, residuals - step)]
    expected = (slopes[0] - slopes[1]) / (2 * step) / _weights(residuals).sum()
    assert curvature_ratio(residuals, _weights(residuals), SCALE) == pytest.approx(
        expected, rel=1e-7
    )


def test_what_is_not_seen_has_no_part_in_the_curvature_ratio(rng):
    seen = rng.normal(0, SCALE, 50)
    some = np.append(seen, np.full(20, UNSEEN))
    share = curvature_ratio(seen, _weights(seen), SCALE)
    assert curvature_ratio(some, _weights(some), SCALE) == pytest.approx(share)


def test_small_residuals_count_as_their_weights_say():
    residuals = np.full(9, 1e-6 * BEND * SCALE)
    assert curvature_ratio(residuals, _weights(residuals), SCALE) == pytest.approx(1)


@given(
    turn=arrays(float, 3, elements=st.floats(-1.5, 1.5)),
    size=st.sampled_from([1e-9, 1e-4, 1e-3, 0.1, 1.0]),
)
def test_the_exponential_turns_by_its_rotation_vector(turn, size):
    T = exponential(np.concatenate([[1.0, 2.0, 3.0], size * turn]))
    rotation = Rotation.from_rotvec(size * turn)
    np.testing.assert_allclose(T[:3, :3], rotation.as_matrix(), rtol=0, atol=1e-15)
    np.testing.assert_array_equal(T[:, 3], [1.0, 2.0, 3.0, 1.0])
    assert rotation_angle(T[:3, :3]) == pytest.approx(rotation.magnitude(), abs=1e-15)
