"""Several shots of each pose never predict worse than one, and no deviation is a false word."""

import numpy as np
import pytest

from servoscope.regression.registry import REGRESSORS

NAMES = sorted(REGRESSORS)
FAST = {"levenberg_marquardt": {"restarts": 1}, "lbfgs": {"restarts": 1, "max_iter": 300}}


def make(name):
    return REGRESSORS[name](**FAST.get(name, {}))


def truth(X):
    return X[:, 0] + 0.5 * np.sin(2 * X[:, 1]) + 0.3 * X[:, 2] ** 2


def shots(n_shots, jitter, noise, seed=0, n_poses=50):
    """Features and targets of all shots, and which is the first shot of each pose."""
    rng = np.random.default_rng(seed)
    counts = rng.integers(1, 21, n_poses) if n_shots == "unequal" else np.full(n_poses, n_shots)
    base = np.repeat(rng.uniform(-1, 1, (n_poses, 6)), counts, axis=0)
    X = base + jitter * rng.normal(size=base.shape)
    y = truth(base) + noise * rng.normal(size=len(base))
    return X, y, np.append(0, np.cumsum(counts)[:-1])


NEW = np.random.default_rng(99).uniform(-1, 1, (400, 6))


def error(regressor, X, y):
    return np.sqrt(np.mean((regressor.fit(X, y).predict(NEW) - truth(NEW)) ** 2))


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    ("n_shots", "jitter", "noise"),
    [
        (2, 0, 0.05),
        (5, 0, 0),
        (5, 1e-4, 0),
        (20, 0, 0.05),
        (20, 1e-2, 0),
        ("unequal", 1e-3, 0.05),
    ],
)
def test_repeated_shots_predict_no_worse_than_one(name, n_shots, jitter, noise):
    X, y, first = shots(n_shots, jitter, noise)
    one = error(make(name), X[first], y[first])
    assert error(make(name), X, y) < 1.5 * one + 0.02


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("noise", [0.02, 0.1])
def test_the_deviation_is_that_of_single_shots(name, noise):
    X, y, _ = shots(5, 1e-3, noise)
    mean, deviation = make(name).fit(X, y).predict(NEW, return_std=True)
    new = truth(NEW) + noise * np.random.default_rng(1).normal(size=len(NEW))
    assert 0.4 < np.sqrt(np.mean(((mean - new) / deviation) ** 2)) < 1.6


@pytest.mark.parametrize("name", NAMES)
def test_the_deviation_without_validation_is_no_training_error(name):
    """Of forty samples with noise, thirty hidden units learn every one by heart."""
    X, y, _ = shots(1, 0, 0.3, n_poses=40)
    mean, deviation = make(name).fit(X, y).predict(NEW, return_std=True)
    new = truth(NEW) + 0.3 * np.random.default_rng(1).normal(size=len(NEW))
    assert 0.5 < np.sqrt(np.mean(((mean - new) / deviation) ** 2)) < 1.8


@pytest.mark.parametrize("name", NAMES)
def test_exactly_repeated_samples_change_no_prediction(name):
    X, y, first = shots(1, 0, 0.05)
    one = make(name).fit(X[first], y[first]).predict(NEW, return_std=True)
    five = make(name).fit(np.repeat(X, 4, axis=0), np.repeat(y, 4))
    np.testing.assert_allclose(five.predict(NEW, return_std=True), one, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("name", NAMES)
def test_validation_by_shots_of_trained_poses_shows_nothing(name):
    """Five shots of each pose in a random order, the last quarter of them validation."""
    X, y, first = shots(5, 1e-4, 0.0)
    order = np.random.default_rng(0).permutation(len(y))
    train, validation = order[:180], order[180:]
    fitted = make(name).fit(X[train], y[train], X[validation], y[validation])
    mean, deviation = fitted.predict(NEW, return_std=True)
    rms = np.sqrt(np.mean((mean - truth(NEW)) ** 2))
    assert rms < 1.5 * error(make(name), X[first], y[first]) + 0.02
    assert rms < 3 * np.median(deviation) + 0.005


def test_poses_may_be_named():
    X, y, _ = shots(3, 0.3, 0.3)
    poses = np.repeat(np.arange(50), 3)
    fitted = make("kernel_ridge").fit(X, y, poses=poses)
    np.testing.assert_allclose(fitted.posterior_.y, y.reshape(50, 3).mean(axis=1))
    with pytest.raises(ValueError, match="poses must be 150 values, one for each sample"):
        fitted.fit(X, y, poses=poses[1:])
