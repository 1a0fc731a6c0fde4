import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

from servoscope.errors import InvalidInputError
from servoscope.kernels import KernelPosterior, fit_kernel
from servoscope.selection.forecast import forecast_errors


def samples(n, noise=0.1, seed=0):
    """Six features, of which two determine the target up to normal noise."""
    rng = np.random.default_rng(seed)
    X = rng.uniform(-1, 1, (n, 6))
    return X, np.sin(2 * X[:, 0]) + X[:, 1] ** 2 + rng.normal(0, noise, n)


def test_the_noise_is_forecast_where_the_features_explain_everything_else():
    X, y = samples(400, noise=0.2)
    forecast = forecast_errors(X, y)
    assert forecast.rms[0] == pytest.approx(0.2, rel=0.12)
    assert forecast.interval[0, 0] < 0.2 < 1.05 * forecast.interval[1, 0]


def test_the_intervals_hold_what_new_samples_reach():
    held, held_of_few = 0, 0
    for seed in range(8):
        X, y = samples(100, noise=0.1, seed=seed)
        X_new, y_new = samples(1000, noise=0.1, seed=1000 + seed)
        kernel = fit_kernel(X, y)
        squares = (KernelPosterior(kernel, X, y).mean(X_new) - y_new) ** 2
        forecast = forecast_errors(X, y)
        low, high = forecast.interval[:, 0]
        held += low <= np.sqrt(np.mean(squares)) <= high
        low, high = forecast.interval_of_test(np.arange(100), np.arange(20))[:, 0]
        few = np.sqrt(squares.reshape(50, 20).mean(axis=1))
        held_of_few += np.mean((low <= few) & (few <= high))
    assert held >= 6
    assert 0.8 < held_of_few / 8 < 0.99


@pytest.mark.filterwarnings("ignore::sklearn.exceptions.ConvergenceWarning")
@pytest.mark.parametrize("n", [40, 120])
def test_it_is_what_a_gaussian_process_of_another_library_reaches_on_new_samples(n):
    """With few samples the error is far above the noise."""
    X, y = samples(n, noise=0.02, seed=0)
    kernel = ConstantKernel() * RBF(np.ones(6), (1e-2, 1e3)) + WhiteKernel(1e-2)
    reached = GaussianProcessRegressor(kernel, normalize_y=True).fit(X, y)
    X_new, y_new = samples(3000, noise=0.02, seed=2)
    rms = np.sqrt(np.mean((reached.predict(X_new) - y_new) ** 2))
    assert 0.6 < forecast_errors(X, y).rms[0] / rms < 1.6


def test_an_unobservable_target_is_forecast_at_its_spread():
    rng = np.random.default_rng(0)
    forecast = forecast_errors(rng.normal(size=(150, 5)), rng.normal(0, 3, 150))
    assert forecast.rms == pytest.approx(forecast.baseline, rel=0.05)
    assert forecast.baseline == pytest.approx([3.0], rel=0.15)
    assert forecast.explained[0] < 0.1


def test_a_target_that_never_changes_is_forecast_without_error():
    X, y = samples(60)
    forecast = forecast_errors(X, np.column_stack([np.full(60, 0.3), y]))
    assert forecast.rms[0] == forecast.baseline[0] == forecast.interval[1, 0] == 0
    assert forecast.explained[0] == 0
    assert forecast.rms[1] > 0


def test_constant_features_explain_nothing():
    y = np.random.default_rng(0).normal(size=100)
    forecast = forecast_errors(np.ones((100, 4)), y)
    assert forecast.rms == pytest.approx(forecast.baseline, rel=0.05)


def test_the_baseline_leaves_the_sample_itself_out():
    y = np.array([0.0, 0, 0, 0, 1, 1, 1, 1])
    others = np.array([(y.sum() - own) / 7 for own in y])
    forecast = forecast_errors(np.ones((8, 1)), y)
    assert forecast.baseline[0] == pytest.approx(np.sqrt(np.mean((y - others) ** 2)))


def test_the_baseline_of_groups_leaves_the_whole_group_out():
    y, groups = np.array([0.0, 1, 5, 2, 8, 9, 1, 1, 3]), np.array([0, 0, 1, 1, 1, 2, 2, 3, 3])
    others = np.array([y[groups != group].mean() for group in groups])
    forecast = forecast_errors(np.ones((9, 1)), y, groups=groups)
    assert forecast.baseline[0] == pytest.approx(np.sqrt(np.mean((y - others) ** 2)))


def test_neighbours_in_a_sequence_flatter_unless_they_are_left_out_together():
    """Features that drift at random follow time, and so does the target."""
    walks = np.cumsum(np.random.default_rng(0).normal(size=(150, 4)), axis=0)
    X, y = walks[:, :3], walks[:, 3]
    together = forecast_errors(X, y, groups=np.arange(150) // 15)
    assert forecast_errors(X, y).rms[0] < 0.6 * together.rms[0]
    assert together.interval[1, 0] / together.rms[0] > 1.1


def test_images_taken_several_times_do_not_flatter():
    rng = np.random.default_rng(0)
    X, y = rng.normal(size=(30, 3)), rng.normal(size=30)
    often = forecast_errors(np.tile(X, (6, 1)), np.tile(y, 6))
    assert often.rms[0] > 0.9 * y.std()


@given(st.integers(0, 100), st.floats(1e-3, 1e3), st.floats(-100, 100))
@settings(max_examples=4)
def test_the_unit_of_a_target_or_of_features_changes_nothing_but_the_unit(seed, unit, shift):
    X, y = samples(40, seed=seed)
    forecast, other = forecast_errors(X, y), forecast_errors(X * 7 + 3, unit * y + shift)
    np.testing.assert_allclose(other.rms, unit * forecast.rms, rtol=0.05)


def test_processes_do_not_change_a_bit():
    X, y = samples(24)
    Y = np.column_stack([y, X[:, 2]])
    alone, shared = forecast_errors(X, Y), forecast_errors(X, Y, n_jobs=2)
    np.testing.assert_array_equal(alone.residuals, shared.residuals)


def test_eight_samples_and_more_features_than_samples_give_a_number():
    rng = np.random.default_rng(0)
    forecast = forecast_errors(rng.normal(size=(8, 40)), rng.normal(size=8))
    assert np.isfinite([*forecast.rms, *forecast.interval.ravel(), *forecast.baseline]).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"X": np.full((20, 2), np.nan)}, "X must be finite"),
        ({"Y": np.full(20, np.inf)}, "y must be finite"),
        ({"Y": np.zeros(19)}, "as many samples, got 20 and 19"),
        ({"X": np.zeros((7, 2)), "Y": np.zeros(7)}, "at least 8 samples, got 7"),
        ({"groups": np.arange(20) // 7}, "at least 4 groups .* got 3"),
        ({"groups": np.arange(5)}, "groups must be 20 values"),
        ({"coverage": 1.0}, "coverage must be"),
    ],
)
def test_bad_input_is_named_in_one_line(change, message):
    rng = np.random.default_rng(0)
    arguments = {"X": rng.normal(size=(20, 2)), "Y": rng.normal(size=20)} | change
    with pytest.raises(InvalidInputError, match=message) as raised:
        forecast_errors(**arguments)
    assert "\n" not in str(raised.value)
