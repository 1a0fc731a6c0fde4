"""Every regressor on samples that are constant, few, huge, tiny, masked or kept in odd ways."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from servoscope.errors import InvalidInputError
from servoscope.regression import LMRegressor
from servoscope.regression.registry import REGRESSORS

SMALL = {
    "levenberg_marquardt": {"hidden": 4, "restarts": 1, "max_iter": 20},
    "lbfgs": {"hidden": 4, "restarts": 1, "max_iter": 50},
    "bayesian_lm": {"hidden": 4},
}


@pytest.fixture(params=sorted(REGRESSORS))
def regressor(request):
    return REGRESSORS[request.param](**SMALL.get(request.param, {}))


def samples(n=40, seed=0):
    rng = np.random.default_rng(seed)
    X = rng.uniform(-1, 1, (n, 3))
    return X, X[:, 0] + X[:, 1] ** 2 + 0.05 * rng.normal(size=n)


def test_one_sample_is_refused(regressor):
    with pytest.raises(ValueError, match=r"1 sample\(s\).* minimum of 2"):
        regressor.fit([[1.0, 2.0]], [3.0])


@pytest.mark.parametrize("value", [0.0, 0.1, -1e10])
def test_a_constant_target_is_predicted_with_a_deviation_that_is_not_none(regressor, value):
    X, _ = samples()
    mean, deviation = regressor.fit(X, np.full(40, value)).predict(X, return_std=True)
    np.testing.assert_allclose(mean, value, rtol=1e-12)
    assert (deviation > 0).all()
    assert deviation.max() <= 1e-11 * max(abs(value), 1)


def test_constant_features_predict_the_mean_and_its_error(regressor):
    y = samples()[1]
    mean, deviation = regressor.fit(np.full((40, 2), 7.0), y).predict([[7.0, 7.0]], return_std=True)
    assert mean[0] == pytest.approx(y.mean(), abs=0.1 * y.std())
    assert deviation[0] == pytest.approx(y.std(), rel=0.25)


@settings(deadline=None, max_examples=8)
@given(
    st.sampled_from(sorted(REGRESSORS)),
    st.sampled_from([1e-25, 1e-9, 1.0, 1e9, 1e25]),
    st.sampled_from([1e-25, 1e-9, 1.0, 1e9, 1e25]),
    st.sampled_from([0.0, 1e4]),
)
def test_scale_and_offset_change_nothing_but_the_unit(name, of_features, of_target, offset):
    """As far as rounding lets the offset: searches end elsewhere by a share of the noise."""
    X, y = samples()
    make = REGRESSORS[name]
    mean, deviation = make(**SMALL.get(name, {})).fit(X, y).predict(X, return_std=True)
    other = make(**SMALL.get(name, {})).fit(of_features * (X + offset), of_target * (y + offset))
    found = other.predict(of_features * (X + offset), return_std=True)
    np.testing.assert_allclose(found[0] / of_target - offset, mean, atol=0.1)
    np.testing.assert_allclose(found[1] / of_target, deviation, rtol=0.5)


@pytest.mark.parametrize("scale", [1e-300, 1e-100, 1e100, 1e300])
def test_what_has_no_squares_is_refused(regressor, scale):
    X, y = samples()
    for arguments in ((scale * X, y), (X, scale * y)):
        with pytest.raises(InvalidInputError, match=r"must be at most 1e\+30 and vary by at least"):
            regressor.fit(*arguments)
    with pytest.raises(InvalidInputError, match=r"X must be at most 1e\+30"):
        regressor.fit(X, y).predict(np.full((1, 3), 1e100))


def test_masked_values_are_refused(regressor):
    X, y = samples()
    hidden = np.ma.masked_greater(X, 0.5), np.ma.masked_greater(y, 0.5)
    for arguments in ((hidden[0], y), (X, hidden[1])):
        with pytest.raises(InvalidInputError, match="values behind a mask"):
            regressor.fit(*arguments)
    with pytest.raises(InvalidInputError, match=r"X hides .* values behind a mask"):
        regressor.fit(X, y).predict(hidden[0])


@pytest.mark.parametrize(
    "cast",
    [
        np.asfortranarray,
        lambda a: np.repeat(a, 2, axis=0)[::2],
        lambda a: a.astype(object),
        lambda a: np.ma.asarray(a),
        lambda a: a.tolist(),
    ],
)
def test_how_numbers_are_kept_does_not_matter(regressor, cast):
    X, y = samples()
    expected = regressor.fit(X, y).predict(X, return_std=True)
    np.testing.assert_array_equal(
        regressor.fit(cast(X), cast(y)).predict(X, return_std=True), expected
    )


@pytest.mark.parametrize("kind", [np.float32, np.int64, np.int8, bool])
def test_other_numbers_count_as_what_they_are(regressor, kind):
    X, y = samples()
    X, y = (100 * X).astype(kind), (100 * y).astype(kind)
    expected = regressor.fit(X.astype(float), y.astype(float)).predict(X.astype(float))
    np.testing.assert_array_equal(regressor.fit(X, y).predict(X), expected)


def test_two_samples_have_a_deviation(regressor):
    _, deviation = regressor.fit([[0.0], [1.0]], [0.0, 1.0]).predict([[0.5]], return_std=True)
    assert np.isfinite(deviation).all()
    assert deviation[0] > 1e-6


def test_an_error_of_none_at_validation_samples_is_not_believed():
    X, _ = samples()
    net = LMRegressor(hidden=2, restarts=1).fit(X, np.zeros(40), X + 0.1, np.zeros(40))
    assert net.predict(X, return_std=True)[1].min() > 0
