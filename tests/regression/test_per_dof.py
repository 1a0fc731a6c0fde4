import numpy as np
import pandas as pd
import pytest
from sklearn.linear_model import LinearRegression
from sklearn.utils.estimator_checks import parametrize_with_checks

from servoscope.errors import InvalidInputError
from servoscope.poses import DOFS
from servoscope.regression import REGRESSORS, GaussianProcess, LMRegressor, PoseRegressor

NAMES = ["f_" + dof for dof in DOFS] + ["noise"]
QUICK = LMRegressor(hidden=4, restarts=1, max_iter=20)

DIFFERENT_BY_DESIGN = {
    "check_fit_score_takes_y": "the target is called delta_p",
    "check_regressors_train": "predictions have one column a dof, also for one dof",
    "check_supervised_y_2d": "a target of one column is as it should be",
}


@parametrize_with_checks(
    [PoseRegressor(dofs=("tx",), regressor=LMRegressor(hidden=3, restarts=1, max_iter=20))],
    expected_failed_checks=lambda _: DIFFERENT_BY_DESIGN,
)
def test_is_a_scikit_learn_estimator(estimator, check):
    # check_array_api_input skips itself: arrays are NumPy's alone.
    check(estimator)


@pytest.fixture
def samples():
    rng = np.random.default_rng(0)
    delta_p = 0.025 * rng.uniform(-1, 1, (200, 6))
    return np.column_stack([np.sinh(20 * delta_p), rng.normal(size=200)]), delta_p


@pytest.fixture
def subsets():
    return {dof: [i] for i, dof in enumerate(DOFS)}


def test_each_dof_is_told_from_its_own_features(samples, subsets):
    X, delta_p = samples
    model = PoseRegressor(subsets, QUICK).fit(X[:150], delta_p[:150], X[150:], delta_p[150:])
    predicted = model.predict(X)
    assert predicted.shape == (200, 6)
    np.testing.assert_allclose(predicted, delta_p, atol=1e-3)
    shaken = X.copy()
    shaken[:, [0, 6]] = 0.0
    np.testing.assert_array_equal(model.predict(shaken)[:, 1:], predicted[:, 1:])


def test_order_of_predictions_is_that_of_the_dofs(samples, subsets):
    X, delta_p = samples
    backwards = dict(reversed(subsets.items()))
    model = PoseRegressor(backwards, LinearRegression()).fit(X, delta_p)
    np.testing.assert_allclose(model.predict(X), delta_p, atol=3e-3)


def test_validation_samples_stop_the_nets(samples, subsets):
    X, delta_p = samples
    model = PoseRegressor(subsets, QUICK).fit(X[:150], delta_p[:150], X[150:], delta_p[150:])
    alone = LMRegressor(hidden=4, restarts=1, max_iter=20).fit(
        X[:150, 2:3], delta_p[:150, 2], X[150:, 2:3], delta_p[150:, 2]
    )
    np.testing.assert_array_equal(model.predict(X)[:, 2], alone.predict(X[:, 2:3]))
    assert np.isfinite(model.regressors_["tz"].result_.validation_rms).all()


def test_subsets_by_name_equal_those_by_column(samples, subsets):
    X, delta_p = samples
    by_name = {dof: ["f_" + dof] for dof in DOFS}
    expected = PoseRegressor(subsets, QUICK).fit(X, delta_p).predict(X)
    named = PoseRegressor(by_name, QUICK, feature_names=NAMES).fit(X, delta_p)
    np.testing.assert_array_equal(named.predict(X), expected)
    frame = pd.DataFrame(X, columns=NAMES)
    from_frame = PoseRegressor(by_name, QUICK).fit(frame, delta_p)
    np.testing.assert_array_equal(from_frame.predict(frame), expected)


def test_all_features_by_default(samples):
    X, delta_p = samples
    model = PoseRegressor(regressor=LinearRegression()).fit(X, delta_p)
    np.testing.assert_allclose(
        model.predict(X), LinearRegression().fit(X, delta_p).predict(X), atol=1e-12
    )


def test_any_number_of_named_targets(samples):
    X, delta_p = samples
    model = PoseRegressor({"pan": [0, 1], "tilt": [1]}, LinearRegression(), dofs=("pan", "tilt"))
    assert model.fit(X, delta_p[:, :2]).predict(X).shape == (200, 2)


def test_arrays_bring_back_the_same_predictions_bit_for_bit(samples, subsets, tmp_path):
    X, delta_p = samples
    model = PoseRegressor(subsets, QUICK).fit(X, delta_p)
    np.savez(tmp_path / "model.npz", **model.to_arrays())
    with np.load(tmp_path / "model.npz", allow_pickle=False) as arrays:
        copy = PoseRegressor.from_arrays(arrays)
    np.testing.assert_array_equal(copy.predict(X), model.predict(X))
    assert copy.subsets == subsets


def test_arrays_of_a_model_fitted_on_a_frame_keep_the_names(samples, subsets):
    X, delta_p = samples
    frame = pd.DataFrame(X, columns=NAMES)
    model = PoseRegressor(subsets, QUICK).fit(frame, delta_p)
    copy = PoseRegressor.from_arrays(model.to_arrays())
    np.testing.assert_array_equal(copy.predict(frame), model.predict(frame))
    with pytest.raises(ValueError, match="feature names should match"):
        copy.predict(frame.rename(columns={"noise": "other"}))


@pytest.mark.parametrize("name", REGRESSORS)
def test_every_regressor_tells_a_deviation_and_comes_back_from_arrays(samples, subsets, name):
    X, delta_p = samples
    model = PoseRegressor(subsets, name).fit(X[:60], delta_p[:60], X[60:90], delta_p[60:90])
    predicted, deviation = model.predict(X, return_std=True)
    assert predicted.shape == deviation.shape == (200, 6)
    assert (deviation > 0).all()
    np.testing.assert_array_equal(model.predict(X), predicted)
    copy = PoseRegressor.from_arrays(model.to_arrays())
    assert {type(regressor) for regressor in copy.regressors_.values()} == {REGRESSORS[name]}
    np.testing.assert_array_equal(copy.predict(X, return_std=True), (predicted, deviation))


def test_the_default_is_the_gaussian_process(samples, subsets):
    X, delta_p = samples
    model = PoseRegressor(subsets).fit(X[:60], delta_p[:60])
    assert {type(regressor) for regressor in model.regressors_.values()} == {GaussianProcess}


def test_arrays_without_a_name_are_of_the_papers_networks(samples, subsets):
    X, delta_p = samples
    model = PoseRegressor(subsets, QUICK).fit(X, delta_p)
    arrays = model.to_arrays()
    old = {k: a for k, a in arrays.items() if not k.endswith((".regressor", ".error"))}
    assert len(old) == len(arrays) - 12
    np.testing.assert_array_equal(PoseRegressor.from_arrays(old).predict(X), model.predict(X))


def test_a_regressor_that_cannot_be_kept_or_is_unknown_is_refused(samples, subsets):
    X, delta_p = samples
    linear = PoseRegressor(subsets, LinearRegression()).fit(X, delta_p)
    with pytest.raises(InvalidInputError, match=r"kept as arrays .* got LinearRegression"):
        linear.to_arrays()
    with pytest.raises(InvalidInputError, match="There is no regressor named 'magic'"):
        PoseRegressor(subsets, "magic").fit(X, delta_p)
    arrays = PoseRegressor(subsets, QUICK).fit(X, delta_p).to_arrays()
    with pytest.raises(InvalidInputError, match="There is no regressor named 'magic'"):
        PoseRegressor.from_arrays(arrays | {"tx.regressor": np.array("magic")})


def test_regressors_fitted_elsewhere_are_joined(samples, subsets):
    X, delta_p = samples
    regressors = {
        dof: LinearRegression().fit(X[:, subsets[dof]], delta_p[:, i]) for i, dof in enumerate(DOFS)
    }
    joined = PoseRegressor.from_fitted(regressors, subsets, n_features=7)
    whole = PoseRegressor(subsets, LinearRegression()).fit(X, delta_p)
    np.testing.assert_array_equal(joined.predict(X), whole.predict(X))


def test_arrays_that_are_not_a_model_are_refused(samples, subsets):
    X, delta_p = samples
    arrays = PoseRegressor(subsets, QUICK).fit(X, delta_p).to_arrays()
    with pytest.raises(InvalidInputError, match="needs the arrays 'dofs' and 'n_features'"):
        PoseRegressor.from_arrays({})
    del arrays["rz.weights"]
    with pytest.raises(InvalidInputError, match="needs the array 'weights'"):
        PoseRegressor.from_arrays(arrays)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"tx": [7]}, "The subset for tx names the feature 7, but X has 7 columns"),
        ({"rz": ["f_rz"]}, "The subset for rz names the feature 'f_rz'"),
        ({"rw": [0]}, "subsets must name tx, ty, tz, rx, ry, rz, got tx, .*rw"),
        ({"ty": []}, "The subset for ty is empty"),
    ],
)
def test_subsets_that_name_nothing_are_refused(samples, subsets, changed, message):
    X, delta_p = samples
    with pytest.raises(InvalidInputError, match=message):
        PoseRegressor(subsets | changed, QUICK).fit(X, delta_p)


def test_a_wrong_number_of_dofs_is_refused(samples):
    X, delta_p = samples
    with pytest.raises(InvalidInputError, match=r"one column for each of tx, ty.* got 5 columns"):
        PoseRegressor().fit(X, delta_p[:, :5])
