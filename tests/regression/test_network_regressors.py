import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.base import clone
from sklearn.model_selection import cross_val_score
from sklearn.utils.estimator_checks import parametrize_with_checks

from servoscope.errors import InvalidInputError
from servoscope.regression import LMRegressor


@parametrize_with_checks([LMRegressor(hidden=5, restarts=1, max_iter=50)])
def test_is_a_scikit_learn_regressor(estimator, check):
    # check_array_api_input skips itself: arrays are NumPy's alone.
    check(estimator)


def _product(n=400, seed=0, noise=0.0):
    rng = np.random.default_rng(seed)
    X = rng.uniform(-2, 2, (n, 2))
    return X, np.sin(X[:, 0]) * X[:, 1] + noise * rng.normal(size=n)


def _fit(X, y, n_train=300, **parameters):
    net = LMRegressor(**parameters)
    return net.fit(X[:n_train], y[:n_train], X[n_train:], y[n_train:])


def test_learns_a_product():
    X, y = _product()
    X_new, y_new = _product(seed=1)
    rms = np.sqrt(np.mean((_fit(X, y).predict(X_new) - y_new) ** 2))
    assert rms < 0.01


def test_keeps_the_start_of_least_validation_error():
    X, y = _product(noise=0.3)
    net = _fit(X, y, restarts=4)
    errors = [result.best_rms for result in net.results_]
    assert len(set(errors)) == 4
    assert net.result_.best_rms == min(errors)
    rms = np.sqrt(np.mean((net.predict(X[300:]) - y[300:]) ** 2))
    assert net.result_.best_rms == pytest.approx(rms, rel=1e-10)


def test_errors_are_in_units_of_the_target():
    X, y = _product(noise=0.3)
    one, thousand = _fit(X, y).result_, _fit(X, 1000 * y).result_
    np.testing.assert_allclose(thousand.validation_rms, 1000 * one.validation_rms, rtol=1e-3)
    np.testing.assert_allclose(thousand.training_rms, 1000 * one.training_rms, rtol=1e-3)


@settings(deadline=None, max_examples=10)
@given(
    factors=st.lists(st.floats(1e-3, 1e3), min_size=3, max_size=3),
    shifts=st.lists(st.floats(-10, 10), min_size=3, max_size=3),
)
def test_predictions_follow_units_of_inputs_and_target(factors, shifts):
    X, y = _product(n=120, noise=0.1)
    scaled_X = X * factors[:2] + shifts[:2] * np.array(factors[:2])
    scaled_y = y * factors[2] + shifts[2] * factors[2]
    options = {"hidden": 5, "restarts": 1, "max_iter": 3}
    expected = _fit(X, y, 90, **options).predict(X) * factors[2] + shifts[2] * factors[2]
    found = _fit(scaled_X, scaled_y, 90, **options).predict(scaled_X)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-3 * factors[2])


def test_the_same_seed_gives_the_same_weights_and_another_seed_others():
    X, y = _product()
    first, again, other = (_fit(X, y, random_state=seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.network_.weights, again.network_.weights)
    assert not np.array_equal(first.network_.weights, other.network_.weights)


def test_a_random_state_draws_a_new_start_each_time():
    X, y = _product()
    drawn = np.random.RandomState(0)
    first, second = (_fit(X, y, random_state=drawn) for _ in range(2))
    assert not np.array_equal(first.network_.weights, second.network_.weights)


def test_a_constant_target_is_predicted_as_it_is():
    X, _ = _product()
    y = np.full(400, 0.1)
    y[300:] = 0.4
    net = _fit(X, y)
    np.testing.assert_allclose(net.predict(X), 0.1, rtol=1e-15)
    assert net.result_.best_rms == pytest.approx(0.3)


def test_a_constant_column_counts_for_nothing():
    X, y = _product(noise=0.1)
    with_constant = np.column_stack([X, np.full(400, 0.1)])
    net = _fit(with_constant, y)
    elsewhere = np.column_stack([X, np.full(400, 55.0)])
    np.testing.assert_array_equal(net.predict(with_constant), net.predict(elsewhere))
    assert net.result_.best_rms < 0.2


def test_early_stopping_beats_training_to_the_end_on_noise():
    rng = np.random.default_rng(0)
    X = rng.normal(size=(200, 10))
    y = X[:, 0] + rng.normal(size=200)
    X_new = rng.normal(size=(500, 10))
    stopped = _fit(X, y, 150).predict(X_new)
    to_the_end = LMRegressor(max_iter=50).fit(X[:150], y[:150]).predict(X_new)
    assert np.std(stopped - X_new[:, 0]) < 0.5 * np.std(to_the_end - X_new[:, 0])


def test_weight_decay_restrains_training_without_validation():
    X, y = _product(n=100, noise=0.5)
    X_new, y_new = _product(seed=1)
    free, decayed = (
        LMRegressor(weight_decay=decay, max_iter=60).fit(X, y).predict(X_new)
        for decay in (0.0, 1.0)
    )
    assert np.std(decayed - y_new) < 0.6 * np.std(free - y_new)


def test_arrays_bring_back_the_same_predictions_bit_for_bit(tmp_path):
    X, y = _product()
    frame = pd.DataFrame(X, columns=["x_50", "theta_50"])
    net = _fit(frame, y)
    np.savez(tmp_path / "net.npz", **net.to_arrays())
    with np.load(tmp_path / "net.npz", allow_pickle=False) as arrays:
        copy = LMRegressor.from_arrays(arrays)
    np.testing.assert_array_equal(copy.predict(frame), net.predict(frame))
    assert copy.feature_names_in_.tolist() == ["x_50", "theta_50"]
    assert copy.n_features_in_ == 2


def test_deviation_is_the_validation_error_and_comes_back_from_arrays():
    X, y = _product(noise=0.3)
    net = _fit(X, y)
    mean, deviation = net.predict(X, return_std=True)
    np.testing.assert_array_equal(mean, net.predict(X))
    np.testing.assert_array_equal(deviation, net.result_.best_rms)
    copy = LMRegressor.from_arrays(net.to_arrays())
    np.testing.assert_array_equal(copy.predict(X, return_std=True)[1], deviation)


def test_deviation_without_validation_is_that_of_new_samples_and_not_of_training():
    """Thirty hidden units learn the noise of eighty samples by heart."""
    X, y = _product(n=80, noise=0.3)
    X_new, y_new = _product(n=2000, seed=1, noise=0.3)
    net = LMRegressor(restarts=1).fit(X, y)
    mean, deviation = net.predict(X_new, return_std=True)
    assert np.std(net.predict(X) - y) < 0.05
    assert 0.5 < np.sqrt(np.mean((mean - y_new) ** 2)) / deviation[0] < 2


def test_arrays_from_before_the_error_was_kept_predict_but_know_no_deviation():
    X, y = _product(n=20)
    net = LMRegressor(max_iter=2).fit(X, y)
    arrays = net.to_arrays()
    del arrays["error"]
    copy = LMRegressor.from_arrays(arrays)
    np.testing.assert_array_equal(copy.predict(X), net.predict(X))
    with pytest.raises(InvalidInputError, match="kept without its error"):
        copy.predict(X, return_std=True)


def test_arrays_of_a_constant_target_bring_it_back():
    X, _ = _product()
    net = LMRegressor(max_iter=2).fit(X, np.full(400, 3.0))
    np.testing.assert_array_equal(LMRegressor.from_arrays(net.to_arrays()).predict(X), 3.0)


def test_arrays_that_do_not_fit_together_are_refused():
    X, y = _product()
    arrays = LMRegressor(max_iter=2).fit(X, y).to_arrays()
    with pytest.raises(InvalidInputError, match="needs the array 'weights'"):
        LMRegressor.from_arrays({k: a for k, a in arrays.items() if k != "weights"})
    with pytest.raises(InvalidInputError, match="do not make a network of 2 inputs"):
        LMRegressor.from_arrays(arrays | {"weights": arrays["weights"][:-1]})
    with pytest.raises(InvalidInputError, match="do not make a network of 2 inputs"):
        LMRegressor.from_arrays(arrays | {"input_scale": np.ones(3)})


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"hidden": 0}, "hidden must be at least 1, got 0"),
        ({"restarts": 0}, "restarts must be at least 1"),
        ({"damping": 0.0}, "damping must be positive"),
        ({"weight_decay": -1.0}, "weight_decay must not be negative"),
        ({"damping": float("nan")}, "damping must be positive"),
    ],
)
def test_parameters_out_of_range_are_refused(parameters, message):
    X, y = _product(n=20)
    with pytest.raises(InvalidInputError, match=message):
        LMRegressor(**parameters).fit(X, y)


def test_half_a_validation_set_is_refused():
    X, y = _product(n=20)
    with pytest.raises(InvalidInputError, match="X_val and y_val belong together"):
        LMRegressor().fit(X, y, X)


def test_bad_samples_are_refused():
    X, y = _product(n=20)
    with pytest.raises(ValueError, match="NaN"):
        LMRegressor().fit(X, y, np.full_like(X, np.nan), y)
    with pytest.raises(ValueError, match=r"0 feature\(s\)"):
        LMRegressor().fit(X[:, :0], y)
    with pytest.raises(ValueError, match="expecting 2 features"):
        LMRegressor().fit(X, y, X[:, :1], y)


def test_works_in_cross_validation():
    X, y = _product(noise=0.1)
    scores = cross_val_score(clone(LMRegressor(hidden=8, restarts=1, max_iter=20)), X, y, cv=3)
    assert min(scores) > 0.9
