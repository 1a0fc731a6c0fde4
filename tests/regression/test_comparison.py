import numpy as np
import pytest
from scipy.stats import norm
from sklearn.base import BaseEstimator

from servoscope.data.splits import split_images
from servoscope.errors import InvalidInputError
from servoscope.regression import (
    REGRESSORS,
    GaussianKernelRidge,
    GaussianProcess,
    LMRegressor,
    compare_regressors,
)


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
    return X, Y, split_images(200)


def test_scores_are_those_reckoned_by_hand(samples):
    X, Y, split = samples
    scores = compare_regressors(X, Y, split, {"mean": MeanAndSpread()}, dofs=("a", "b"), n_jobs=1)
    for score, y in zip(scores, Y.T, strict=True):
        error = y[split.test] - y[split.train].mean()
        half_width = norm.ppf(0.975) * y[split.validation].std()
        assert score.test_rms == pytest.approx(np.sqrt(np.mean(error**2)))
        assert score.coverage == pytest.approx(np.mean(np.abs(error) < half_width))
        assert score.interval_width == pytest.approx(2 * half_width)


def test_scores_come_by_regressor_and_dof_and_progress_counts_them(samples):
    counts = []
    scores = compare_regressors(
        *samples, ["kernel_ridge", "lbfgs"], dofs=("a", "b"), n_jobs=1, on_progress=counts.append
    )
    names = [(score.regressor, score.dof) for score in scores]
    assert names == [(r, d) for r in ("kernel_ridge", "lbfgs") for d in ("a", "b")]
    assert counts == [1, 2, 3, 4]


def test_every_regressor_is_compared_and_covers_about_as_much_as_it_says(samples):
    scores = compare_regressors(*samples, dofs=("a", "b"), n_jobs=1)
    assert {score.regressor for score in scores} == set(REGRESSORS)
    for score in scores:
        assert score.test_rms < 0.1
        assert 0.75 < score.coverage <= 1
        assert score.fit_seconds > 0


def test_scores_are_the_same_for_any_number_of_processes(samples):
    quick = {
        "gaussian_process": GaussianProcess(),
        "kernel_ridge": GaussianKernelRidge(),
        "levenberg_marquardt": LMRegressor(restarts=1, max_iter=5),
    }
    one, two = (
        compare_regressors(*samples, quick, dofs=("a", "b"), n_jobs=n_jobs) for n_jobs in (1, 2)
    )
    assert one == two


def test_each_dof_is_told_from_its_own_columns(samples):
    X, Y, split = samples
    shaken = X.copy()
    shaken[:, 3:] = 0.0
    columns = {"a": [0, 1, 2], "b": [3, 4]}
    before, after = (
        compare_regressors(
            features, Y, split, ["kernel_ridge"], columns=columns, dofs=("a", "b"), n_jobs=1
        )
        for features in (X, shaken)
    )
    assert before[0] == after[0]
    assert after[1].test_rms > 2 * before[1].test_rms


def test_test_samples_that_decide_are_refused(samples):
    X, Y, _ = samples
    with pytest.raises(InvalidInputError, match="under the honest protocol"):
        compare_regressors(X, Y, split_images(200, "paper"), dofs=("a", "b"))


def test_bad_input_is_refused(samples):
    X, Y, split = samples
    with pytest.raises(InvalidInputError, match=r"\(n, 6\), got \(200, 5\) and \(200, 2\)"):
        compare_regressors(X, Y, split)
    with pytest.raises(InvalidInputError, match="must be finite"):
        compare_regressors(np.full_like(X, np.nan), Y, split, dofs=("a", "b"))
    with pytest.raises(InvalidInputError, match="There is no regressor named 'magic'"):
        compare_regressors(X, Y, split, ["magic"], dofs=("a", "b"))
