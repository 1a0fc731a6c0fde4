"""Pose vectors: they tell the dofs apart, and turn away from what disturbances change."""

import numpy as np
from sklearn.linear_model import Ridge

from servoscope.positioning.pose_vectors import (
    PRODUCTS,
    RIDGE,
    compute_pose_vectors,
    pose_vector_names,
)


def test_they_are_the_ridge_regression_of_another_library(rng) -> None:
    delta_p = rng.uniform(-1, 1, (400, 6))
    seen = delta_p @ rng.normal(size=(6, 20)) + 0.3 * rng.normal(size=(400, 20))
    targets = np.column_stack([delta_p, *(delta_p[:, i] * delta_p[:, j] for i, j in PRODUCTS)])
    variance = ((seen - seen.mean(axis=0)) ** 2).sum() / 20
    expected = Ridge(alpha=RIDGE * variance).fit(seen, targets).coef_
    vectors = compute_pose_vectors(seen.astype(np.float32), delta_p)
    np.testing.assert_allclose(vectors, expected, atol=1e-4)
    assert len(vectors) == len(pose_vector_names()) == 27


def test_they_turn_away_from_what_differs_between_copies_of_a_pose(rng) -> None:
    delta_p = rng.uniform(-1, 1, (500, 6))
    disturbed = rng.normal(size=(6, 8))
    clean = np.repeat(delta_p @ rng.normal(size=(6, 8)), 3, axis=0)
    change = 3 * rng.normal(size=(1500, 1)) * disturbed[:1]
    p = np.repeat(delta_p, 3, axis=0)
    before, after = (
        compute_pose_vectors(seen.astype(np.float32), p)[:6] for seen in (clean, clean + change)
    )
    assert np.abs(after @ disturbed[0]).max() < 0.02 * np.abs(before @ disturbed[0]).max()


def test_values_that_never_change_count_for_nothing(rng) -> None:
    delta_p = rng.uniform(-1, 1, (100, 6))
    seen = np.column_stack([delta_p, np.full(100, 0.3)]).astype(np.float32)
    assert np.abs(compute_pose_vectors(seen, delta_p)[:, 6]).max() < 1e-4
