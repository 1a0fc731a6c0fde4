"""Which samples are shots of one pose, and what is learned from them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from servoscope.kernels import (
    find_repeats,
    fit_kernel,
    inverse_covariance,
    leave_out_residuals,
    merge_repeats,
    shots_left_out,
    whole_poses,
)


def shots(counts, n_features=4, jitter=0.0, noise=0.0, seed=0):
    """Samples of as many poses, each as often as it is said, in a random order; and the poses."""
    rng = np.random.default_rng(seed)
    poses = np.repeat(np.arange(len(counts)), counts)
    base = rng.uniform(-1, 1, (len(counts), n_features))
    X = base[poses] + jitter * rng.normal(size=(len(poses), n_features))
    y = (base[:, 0] + base[:, 1] ** 2)[poses] + noise * rng.normal(size=len(poses))
    order = rng.permutation(len(poses))
    return X[order], y[order], poses[order]


def same_groups(a, b):
    return len(set(zip(a.tolist(), b.tolist(), strict=True))) == len(set(a)) == len(set(b))


@settings(max_examples=20, deadline=None)
@given(
    st.lists(st.integers(1, 20), min_size=20, max_size=60),
    st.sampled_from([0.0, 1e-9, 1e-4, 1e-3]),
    st.sampled_from([0.0, 1e-3, 0.1]),
    st.integers(3, 8),
    st.sampled_from([1.0, -3.0, 1e3]),
)
def test_shots_of_one_pose_are_found(counts, jitter, noise, n_features, unit):
    counts[:10] = [5] * 10
    X, y, poses = shots(counts, n_features, jitter, noise)
    found = find_repeats(X + unit, unit * y)
    assert len(set(zip(found.tolist(), poses.tolist(), strict=True))) == len(
        counts
    )  # none is split
    assert found.max() + 1 >= len(counts) - 2  # two poses may be alike by chance


def test_shots_that_differ_by_a_billionth_are_of_one_pose():
    X, y, poses = shots([5] * 10 + [1] * 10, 3, 1e-9, 1e-3)
    assert same_groups(find_repeats(X + 1.0, y), poses)


@settings(max_examples=20, deadline=None)
@given(st.integers(1, 8), st.integers(2, 300), st.integers(0, 10**6), st.booleans())
def test_independent_samples_are_each_by_itself(n_features, n, seed, uniform):
    rng = np.random.default_rng(seed)
    X = rng.uniform(size=(n, n_features)) if uniform else rng.normal(size=(n, n_features))
    groups = find_repeats(X, np.sin(3 * X[:, 0]))
    assert groups.max() + 1 >= n - 3  # of a few in one dimension, two may happen to be next


@pytest.mark.parametrize("jitter", [0.03, 0.1])
def test_equal_targets_show_one_pose_where_features_are_noisy(jitter):
    X, y, poses = shots([5] * 60, 6, jitter)
    assert same_groups(find_repeats(X, y), poses)


def test_encoders_that_never_repeat_a_pose_exactly_show_it_by_all_dofs_together():
    X, _, poses = shots([5] * 60, 6, 0.05)
    rng = np.random.default_rng(1)
    Y = rng.uniform(-1, 1, (60, 3))[poses] + 1e-6 * rng.normal(size=(300, 3))
    assert same_groups(find_repeats(X, Y), poses)


def test_levels_are_no_poses():
    """A grid, a discrete target, a target that never changes, clusters of different poses."""
    rng = np.random.default_rng(0)
    grid = np.stack(np.meshgrid(range(20), range(20)), axis=-1).reshape(-1, 2) / 20.0
    near = rng.normal(size=(300, 3))
    far = 100.0 * rng.normal(size=(10, 3))[np.arange(300) % 10] + near
    samples = (
        (grid, grid[:, 0]),
        (rng.normal(size=(200, 1)), rng.integers(0, 2, 200)),
        (rng.normal(size=(40, 3)), np.ones(40)),
        (far, near[:, 0]),
        (np.ones((30, 2)), rng.normal(size=30)),
    )
    for X, y in samples:
        assert len(np.unique(find_repeats(X, y.astype(float)))) == len(X)


@pytest.mark.parametrize("n", [30, 150])
@pytest.mark.parametrize("n_features", [2, 6])
def test_rings_about_the_reference_are_no_repeated_poses(n, n_features):
    rng = np.random.default_rng(0)
    poses = np.concatenate([s * rng.uniform(-1, 1, (n, n_features)) for s in (1.0, 0.1, 0.01)])
    assert len(np.unique(find_repeats(poses, poses))) == 3 * n


def test_poses_are_the_means_of_their_shots():
    X, y, poses = shots([3] * 20, jitter=1e-4, noise=0.1)
    groups = find_repeats(X, y)
    X_mean, y_mean = merge_repeats(X, y, groups)
    for pose in range(20):
        own = groups[np.flatnonzero(poses == pose)[0]]
        np.testing.assert_allclose(X_mean[own], X[poses == pose].mean(axis=0))
        np.testing.assert_allclose(y_mean[own], y[poses == pose].mean())


def test_groups_that_divide_a_pose_are_joined():
    poses, groups = np.array([0, 0, 1, 2, 2, 3]), np.array([0, 1, 1, 2, 2, 3])
    assert whole_poses(poses, groups).tolist() == [0, 0, 0, 1, 1, 2]


@pytest.mark.parametrize("n_groups", [None, 10])
def test_residuals_of_shots_are_those_of_models_without_their_group(n_groups):
    X, y, poses = shots([3] * 30, jitter=0.02, noise=0.1)
    means = merge_repeats(X, y, poses)
    groups = None if n_groups is None else np.arange(30) % n_groups
    kernel = fit_kernel(*means, max_iter=10)
    found = shots_left_out(kernel, *means, groups, (X, y, poses))
    units = np.arange(30) if groups is None else groups
    for i in range(0, len(y), 7):
        kept = units != units[poses[i]]
        inverse, _ = inverse_covariance(kernel, means[0][kept])
        weights = inverse @ (means[1][kept] - kernel.offset)
        mean = kernel.offset + kernel(X[[i]], means[0][kept]) @ weights
        assert found[i] == pytest.approx(y[i] - mean[0], abs=1e-8)


def test_samples_that_are_no_shots_have_the_residuals_of_samples():
    X, y, _ = shots([1] * 30)
    kernel = fit_kernel(X, y, max_iter=10)
    found = shots_left_out(kernel, X, y, None, (X, y, np.arange(30)))
    np.testing.assert_allclose(found, leave_out_residuals(kernel, X, y), atol=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_a_target_that_bends_often_is_no_noise(seed):
    """From the usual start alone, three of these four end at noise and nothing else."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(-1, 1, (40, 1))
    kernel = fit_kernel(x, np.sin(12 * x[:, 0]) + 0.02 * rng.normal(size=40))
    assert kernel.noise < 0.1
