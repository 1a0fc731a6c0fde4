"""The loop that fits regressors side by side."""

import numpy as np
import pytest
from scipy.stats import norm
from sklearn.base import BaseEstimator

from servoscope.data.splits import Split, split_images
from servoscope.errors import InvalidInputError
from servoscope.pipeline import FeatureTable, Recipe, fit_all
from servoscope.regression import REGRESSORS, LMRegressor

NAMES = ("a", "b", "c", "d", "e")
SPLIT = split_images(200)
QUICK = {"levenberg_marquardt": {"restarts": 1, "max_iter": 5}}


class MeanAndSpread(BaseEstimator):
    """Knows no feature: what it says can be reckoned by hand."""

    def fit(self, X, y, X_val=None, y_val=None):
        self.mean_, self.spread_ = y.mean(), y_val.std()
        return self

    def predict(self, X, return_std=False):
        return np.full(len(X), self.mean_), np.full(len(X), self.spread_)


@pytest.fixture(scope="module")
def samples():
    rng = np.random.default_rng(0)
    Y = rng.uniform(-1, 1, (200, 2))
    X = np.tanh(Y @ rng.normal(size=(2, 5))) + 0.02 * rng.normal(size=(200, 5))
    return FeatureTable(X, NAMES, ("own",) * 5), Y


def fit(samples, recipes, **options):
    jobs = [(recipe, dof) for recipe in recipes for dof in ("tx", "ty")]
    options = {"n_jobs": 1, "dofs": ("tx", "ty")} | options
    return fit_all(*samples, options.pop("split", SPLIT), jobs, **options)


def test_errors_are_those_reckoned_by_hand(samples):
    fitted = fit(samples, [Recipe("own", regressor=MeanAndSpread())])
    for one, y in zip(fitted, samples[1].T, strict=True):
        error = y[SPLIT.test] - y[SPLIT.train].mean()
        half_width = norm.ppf(0.975) * y[SPLIT.validation].std()
        assert one.test_rms == pytest.approx(np.sqrt(np.mean(error**2)))
        assert one.coverage == pytest.approx(np.mean(np.abs(error) < half_width))
        assert one.interval_width == pytest.approx(2 * half_width)
        np.testing.assert_allclose(-one.errors, error)


def test_every_regressor_covers_about_as_much_as_it_says(samples):
    for one in fit(samples, [Recipe("own", regressor=name) for name in REGRESSORS]):
        assert one.test_rms < 0.1
        assert 0.75 < one.coverage <= 1
        assert one.seconds > 0


def test_they_come_in_the_order_of_the_jobs_the_same_for_any_number_of_processes(samples):
    recipes = [
        Recipe("own", regressor=name, settings=QUICK.get(name, {}))
        for name in ("gaussian_process", "kernel_ridge", "levenberg_marquardt")
    ]
    counts = []
    one, two = (fit(samples, recipes, n_jobs=n, on_progress=counts.append) for n in (1, 2))
    assert counts == [1, 2, 3, 4, 5, 6] * 2
    assert [(a.recipe, a.dof) for a in one] == [(r, dof) for r in recipes for dof in ("tx", "ty")]
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a.errors, b.errors)


def test_a_network_is_that_of_the_regressor_alone(samples):
    table, Y = samples
    settings = {"hidden": 30, "restarts": 2, "max_iter": 6, "random_state": 4}
    recipe = Recipe("own", ("d", "e", "b"), "levenberg_marquardt", settings)
    net = fit(samples, [recipe])[1].regressor
    X, train, stop = table.values[:, [3, 4, 1]], SPLIT.train, SPLIT.validation
    alone = LMRegressor(**settings).fit(X[train], Y[train, 1], X[stop], Y[stop, 1])
    np.testing.assert_array_equal(net.network_.weights, alone.network_.weights)


def test_each_recipe_takes_its_own_columns(samples):
    table, Y = samples
    shaken = table.values.copy()
    shaken[:, 3:] = 0.0
    recipes = [Recipe("own", c, "kernel_ridge") for c in (("a", "b", "c"), ("d", "e"))]
    before, after = (
        fit((FeatureTable(X, NAMES, table.families), Y), recipes) for X in (table.values, shaken)
    )
    assert before[0].test_rms == after[0].test_rms
    assert after[2].test_rms > 2 * before[2].test_rms


def test_repeated_shots_of_a_pose_count_as_one(samples):
    table, Y = samples
    X, often = table.values[:50], np.repeat(np.arange(50), 4)
    recipe = Recipe("own", regressor="kernel_ridge")
    nothing = np.arange(0)
    once = fit((FeatureTable(X, NAMES, table.families), Y[:50]), [recipe], split=_train(50))
    four = fit(
        (FeatureTable(X[often], NAMES, table.families), Y[:50][often]),
        [recipe],
        split=Split(np.arange(200), nothing, nothing),
    )
    for a, b in zip(once, four, strict=True):
        np.testing.assert_allclose(
            a.regressor.predict(table.values), b.regressor.predict(table.values), atol=1e-6
        )


def _train(n: int) -> Split:
    return Split(np.arange(n), np.arange(0), np.arange(0))


def test_bad_input_is_refused(samples):
    table, Y = samples
    recipe = Recipe("own", regressor="kernel_ridge")
    with pytest.raises(InvalidInputError, match=r"\(n, 6\), got \(200, 5\) and \(200, 2\)"):
        fit_all(table, Y, SPLIT, [(recipe, "tx")])
    with pytest.raises(InvalidInputError, match="must be finite"):
        fit((table, np.full_like(Y, np.nan)), [recipe])
    with pytest.raises(InvalidInputError, match=r"targets hides .* behind a mask"):
        fit((table, np.ma.masked_greater(Y, 0.5)), [recipe])
    with pytest.raises(InvalidInputError, match="At least two images must train, got 1"):
        fit(samples, [recipe], split=_train(1))
    with pytest.raises(InvalidInputError, match="must be from 0 to 199"):
        fit(samples, [recipe], split=_train(201))
    with pytest.raises(InvalidInputError, match="The recipe takes w of own"):
        fit(samples, [Recipe("own", ("w",))])
    with pytest.raises(InvalidInputError, match="There is no regressor named 'magic'"):
        fit(samples, [Recipe("own", regressor="magic")])
    with pytest.raises(ValueError, match="at most"):
        fit((table, 1e200 * Y), [recipe])
