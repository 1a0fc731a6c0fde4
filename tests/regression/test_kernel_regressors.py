import numpy as np
import pandas as pd
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel
from sklearn.kernel_ridge import KernelRidge
from sklearn.utils.estimator_checks import parametrize_with_checks

from servoscope.errors import InvalidInputError
from servoscope.kernels import GaussianKernel, leave_out_residuals
from servoscope.kernels.gaussian import KernelPosterior
from servoscope.regression import GaussianKernelRidge, GaussianProcess, kernel_regressors


@pytest.fixture(params=[GaussianProcess, GaussianKernelRidge])
def estimator(request):
    return request.param()


@parametrize_with_checks([GaussianProcess(), GaussianKernelRidge()])
def test_is_a_scikit_learn_regressor(estimator, check):
    # check_array_api_input skips itself: arrays are NumPy's alone.
    check(estimator)


def _product(n=150, seed=0, noise=0.05, n_idle=1):
    rng = np.random.default_rng(seed)
    X = rng.uniform(-2, 2, (n, 2 + n_idle))
    return X, np.sin(X[:, 0]) * X[:, 1] + noise * rng.normal(size=n)


@pytest.fixture
def posterior():
    X, y = _product(40)
    kernel = GaussianKernel(X.mean(axis=0), np.array([1.0, 2.0, np.inf]), 1.5, 0.1, offset=0.3)
    return KernelPosterior(kernel, X, y)


def test_mean_and_deviation_equal_those_of_scikit_learn(posterior):
    X, y = posterior.X, posterior.y
    X_new, _ = _product(20, seed=1)
    kernel = ConstantKernel(1.5**2) * RBF([1.0, 2.0, 1e9])
    other = GaussianProcessRegressor(kernel, alpha=0.1**2 + 1e-9 * 1.5**2, optimizer=None)
    mean, deviation = other.fit(X, y - 0.3).predict(X_new, return_std=True)
    np.testing.assert_allclose(posterior.mean(X_new), mean + 0.3, rtol=1e-8)
    np.testing.assert_allclose(posterior.deviation(X_new), np.hypot(deviation, 0.1), rtol=1e-8)


def test_gradient_equals_central_differences(posterior):
    X_new, _ = _product(20, seed=1)
    step = 1e-5
    differences = [
        (posterior.mean(X_new + step * e) - posterior.mean(X_new - step * e)) / (2 * step)
        for e in np.eye(3)
    ]
    gradient = posterior.gradient(X_new)
    np.testing.assert_allclose(gradient, np.transpose(differences), atol=1e-8)
    np.testing.assert_array_equal(gradient[:, 2], 0)


def test_gradient_is_that_of_the_prediction_in_the_features_own_units(estimator):
    X, y = _product()
    X *= (10.0, 0.1, 3.0)
    estimator.fit(X, y)
    step = 1e-5 * X.std(axis=0)
    differences = [
        (estimator.predict(X + e) - estimator.predict(X - e)) / (2 * e.max()) for e in np.diag(step)
    ]
    gradient = estimator.gradient(X)
    np.testing.assert_allclose(
        gradient, np.transpose(differences), atol=1e-5 * np.abs(gradient).max()
    )


def test_learns_a_product(estimator):
    X, y = _product()
    X_new, y_new = _product(500, seed=1, noise=0.0)
    assert np.std(estimator.fit(X, y).predict(X_new) - y_new) < 0.1


def test_kernel_ridge_is_that_of_scikit_learn_with_the_least_error_left_out():
    X, y = _product(9, n_idle=0)
    ours = GaussianKernelRidge().fit(X, y)
    Z, mean = (X - X.mean(axis=0)) / X.std(axis=0), y.mean()
    errors = {}
    for length_scale in (0.5, 1.0, 2.0, 4.0, 8.0, 16.0):
        for ridge in 10.0 ** np.arange(-7, 1, 0.5):
            other = KernelRidge(kernel="rbf", alpha=ridge, gamma=0.25 / length_scale**2)
            left_out = [
                y[i] - mean - other.fit(Z[others], y[others] - mean).predict(Z[[i]])[0]
                for i in range(9)
                for others in [np.delete(np.arange(9), i)]
            ]
            errors[length_scale, ridge] = np.sum(np.square(left_out))
    length_scale, ridge = min(errors, key=errors.get)
    kernel = ours.kernel_
    np.testing.assert_allclose(kernel.length_scales, length_scale * np.sqrt(2) * X.std(axis=0))
    assert (kernel.noise / kernel.signal) ** 2 == pytest.approx(ridge)
    other = KernelRidge(kernel="rbf", alpha=ridge, gamma=0.25 / length_scale**2).fit(Z, y - mean)
    np.testing.assert_allclose(ours.predict(X), other.predict(Z) + mean, atol=1e-4)


def test_kernel_ridge_expects_errors_as_large_as_those_left_out():
    X, y = _product()
    ridge = GaussianKernelRidge().fit(X, y)
    residuals = leave_out_residuals(ridge.kernel_, X, y)
    expected = 1 / np.sqrt(np.diag(ridge.posterior_.inverse))
    assert np.mean((residuals / expected) ** 2) == pytest.approx(1, rel=1e-3)


@pytest.mark.parametrize("with_validation", [False, True])
def test_the_predicted_deviation_covers_new_targets(estimator, with_validation):
    X, y = _product(300, noise=0.2)
    X_new, y_new = _product(2000, seed=1, noise=0.2)
    parts = (X[:150], y[:150], X[150:], y[150:]) if with_validation else (X, y)
    mean, deviation = estimator.fit(*parts).predict(X_new, return_std=True)
    assert 0.9 < np.mean(np.abs(y_new - mean) < 1.96 * deviation) < 0.985


def test_doubt_grows_away_from_the_samples_and_never_falls_below_the_noise(estimator):
    X, y = _product(noise=0.2)
    estimator.fit(X, y)
    _, near = estimator.predict(X, return_std=True)
    _, far = estimator.predict(X + 50, return_std=True)
    assert near.min() >= estimator.kernel_.noise
    np.testing.assert_allclose(far, np.hypot(estimator.kernel_.signal, estimator.kernel_.noise))
    assert far.min() > 2 * near.max()


def test_validation_samples_are_learned_from(estimator):
    X, y = _product(noise=0.0)
    half = X[:, 0] < 0
    alone = estimator.fit(X[half], y[half]).predict(X[~half])
    both = estimator.fit(X[half], y[half], X[~half], y[~half]).predict(X[~half])
    assert np.std(both - y[~half]) < 0.1 * np.std(alone - y[~half])


def test_validation_errors_set_the_deviation_and_no_prediction(estimator, monkeypatch):
    """Enough samples train for the kernel to be found from them alone."""
    monkeypatch.setattr(kernel_regressors, "KERNEL_SAMPLES", 60)
    X, y = _product(70)
    X_val, y_val = _product(100, seed=1)
    off = y_val + np.random.default_rng(2).normal(size=100)
    estimator.fit(X, y)
    kernel = estimator.kernel_
    expected = estimator.posterior_.deviation(X_val)
    calibration_ratio = np.sqrt(np.mean(((off - estimator.predict(X_val)) / expected) ** 2))
    estimator.fit(X, y, X_val, off)
    assert estimator.kernel_.noise == pytest.approx(calibration_ratio * kernel.noise)
    assert estimator.kernel_.signal == pytest.approx(calibration_ratio * kernel.signal)
    assert calibration_ratio > 5


def test_samples_beyond_the_limit_are_left_out(estimator):
    X, y = _product(80)
    estimator.set_params(max_samples=50).fit(X, y)
    assert estimator.posterior_.X.shape == (50, 3)
    with pytest.raises(InvalidInputError, match="max_samples must be at least 1, got 0"):
        estimator.set_params(max_samples=0).fit(X, y)


def test_idle_and_constant_features_are_harmless(estimator):
    X, y = _product(n_idle=0)
    constant = np.column_stack([X, np.full(len(X), 0.1)])
    plain = estimator.fit(X, y).predict(X)
    np.testing.assert_allclose(estimator.fit(constant, y).predict(constant), plain, atol=1e-8)
    elsewhere = np.column_stack([X, np.full(len(X), 55.0)])
    np.testing.assert_allclose(estimator.predict(elsewhere), plain, atol=1e-8)
    np.testing.assert_array_equal(estimator.gradient(constant)[:, 2], 0)


def test_a_constant_target_is_predicted_as_it_is(estimator):
    X, _ = _product()
    mean, deviation = estimator.fit(X, np.full(150, 0.1)).predict(X, return_std=True)
    np.testing.assert_allclose(mean, 0.1, rtol=1e-14)
    assert 0 < deviation.min() <= deviation.max() < 1e-12
    np.testing.assert_array_equal(estimator.gradient(X), 0)


def test_constant_features_predict_the_mean(estimator):
    y = np.array([1.0, 2.0, 6.0])
    mean, deviation = estimator.fit(np.ones((3, 2)), y).predict(np.ones((1, 2)), return_std=True)
    assert mean[0] == pytest.approx(3.0)
    about_others = [1.0 - 4.0, 2.0 - 3.5, 6.0 - 1.5]
    assert deviation[0] == pytest.approx(np.sqrt(np.mean(np.square(about_others))))


@pytest.mark.parametrize("n", [2, 3, 9])
@pytest.mark.parametrize("n_features", [1, 12])
@pytest.mark.parametrize("repeated", [1, 4])
def test_few_and_repeated_samples_give_finite_answers(estimator, n, n_features, repeated):
    rng = np.random.default_rng(0)
    X, y = rng.normal(size=(n, n_features)), rng.normal(size=n)
    estimator.fit(np.tile(X, (repeated, 1)), np.tile(y, repeated))
    for answer in (*estimator.predict(X, return_std=True), estimator.gradient(X)):
        assert np.isfinite(answer).all()


def test_the_same_samples_give_the_same_answer_bit_for_bit(estimator):
    X, y = _product()
    first = estimator.fit(X, y).predict(X, return_std=True)
    again = estimator.fit(X, y).predict(X, return_std=True)
    np.testing.assert_array_equal(first, again)


def test_the_order_of_the_samples_in_memory_does_not_matter(estimator):
    X, y = _product()
    expected = estimator.fit(X, y).predict(X, return_std=True)
    other = np.asfortranarray(X)
    np.testing.assert_array_equal(estimator.fit(other, y).predict(X, return_std=True), expected)


def test_arrays_bring_back_the_same_predictions_bit_for_bit(estimator, tmp_path):
    X, y = _product()
    frame = pd.DataFrame(X, columns=["x_50", "theta_50", "e_00"])
    estimator.fit(frame[:100], y[:100], frame[100:], y[100:])
    np.savez(tmp_path / "regressor.npz", **estimator.to_arrays())
    with np.load(tmp_path / "regressor.npz", allow_pickle=False) as arrays:
        copy = type(estimator).from_arrays(arrays)
    for ours, theirs in zip(
        copy.predict(frame, return_std=True),
        estimator.predict(frame, return_std=True),
        strict=True,
    ):
        np.testing.assert_array_equal(ours, theirs)
    np.testing.assert_array_equal(copy.gradient(frame), estimator.gradient(frame))
    assert copy.feature_names_in_.tolist() == ["x_50", "theta_50", "e_00"]


def test_arrays_that_do_not_fit_together_are_refused():
    X, y = _product()
    arrays = GaussianKernelRidge().fit(X, y).to_arrays()
    with pytest.raises(InvalidInputError, match="needs the array 'signal'"):
        GaussianProcess.from_arrays({k: a for k, a in arrays.items() if k != "signal"})
    with pytest.raises(InvalidInputError, match=r"149 targets .* do not belong together"):
        GaussianProcess.from_arrays(arrays | {"targets": y[1:]})
    with pytest.raises(InvalidInputError, match="2 length scales"):
        GaussianProcess.from_arrays(arrays | {"length_scales": np.ones(2)})


def test_half_a_validation_set_is_refused(estimator):
    X, y = _product()
    with pytest.raises(InvalidInputError, match="X_val and y_val belong together"):
        estimator.fit(X, y, X)
