import numpy as np
import pytest
from sklearn.cross_decomposition import PLSRegression

from refitted import crossfit_forecast, refit_features
from servoscope.errors import InvalidInputError
from servoscope.kernels import KernelPosterior, fit_kernel
from servoscope.selection.forecast import Fold, cut_folds, forecast_errors, forecast_from_folds


class Pixels:
    """Features that need no fitting."""

    def fit(self, images, Y):
        return self

    def transform(self, images):
        return images.reshape(len(images), -1)


class Supervised:
    """Directions fitted to the targets, as those of pose-image covariance are."""

    def fit(self, images, Y):
        self.fitted = PLSRegression(2).fit(images, Y)
        self.images = images
        return self

    def transform(self, images):
        return self.fitted.transform(images)


def images_and_noise(n=120, width=60, seed=0):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(n, width)), rng.normal(size=n)


def test_features_fitted_to_noise_explain_nothing_in_new_images():
    images, y = images_and_noise()
    flattered = forecast_errors(Supervised().fit(images, y).transform(images), y)
    honest = crossfit_forecast(Supervised(), images, y)
    assert flattered.rms[0] < 0.8 * flattered.baseline[0]
    assert honest.rms[0] > 0.95 * honest.baseline[0]


def test_features_that_need_no_fitting_have_the_forecast_of_closed_form():
    rng = np.random.default_rng(0)
    images = rng.uniform(-1, 1, (200, 3))
    Y = np.column_stack([np.sin(2 * images[:, 0]), images[:, 1] * images[:, 2]])
    Y += rng.normal(0, 0.1, Y.shape)
    folds, closed = crossfit_forecast(Pixels(), images, Y), forecast_errors(images, Y)
    np.testing.assert_allclose(folds.rms, closed.rms, rtol=0.1)
    np.testing.assert_array_equal(folds.baseline, closed.baseline)


def test_the_error_is_that_of_all_images_and_not_of_those_that_are_left():
    ratios = []
    for seed in range(4):
        X = np.random.default_rng(seed).uniform(-1, 1, (600, 2))
        y = np.sin(5 * X[:, 0]) + np.random.default_rng(seed).normal(0, 0.1, 600)
        few, new = np.arange(60), np.arange(60, 600)
        reached = forecast_from_folds([Fold(new, X)], y).residuals[new, 0]
        forecast = crossfit_forecast(Pixels(), X[few], y[few])
        ratios.append(forecast.rms[0] / np.sqrt(np.mean(reached**2)))
    assert 0.75 < np.median(ratios) < 1.33


def test_what_is_hoped_from_the_images_left_out_lowers_the_error_by_a_fifth_at_most():
    rng = np.random.default_rng(0)
    X = rng.uniform(-1, 1, (80, 3))
    y = np.sin(3 * X[:, 0]) * X[:, 1] + rng.normal(0, 0.02, 80)
    errors = np.empty(80)
    for fold in refit_features(Pixels(), X, y, n_folds=2):
        used = np.delete(np.arange(80), fold.left_out)
        kernel = fit_kernel(X[used], y[used], max_iter=25)
        errors[fold.left_out] = y[fold.left_out] - KernelPosterior(kernel, X[used], y[used]).mean(
            X[fold.left_out]
        )
    gain = crossfit_forecast(Pixels(), X, y, n_folds=2).rms[0] / np.sqrt(np.mean(errors**2))
    assert 0.799 < gain < 0.95


def test_groups_are_left_out_as_a_whole():
    images, y = images_and_noise(60, 2)
    groups = np.arange(60) // 6
    for fold in refit_features(Pixels(), images, y, groups=groups):
        assert not np.isin(groups[fold.left_out], np.delete(groups, fold.left_out)).any()


def test_columns_choose_features():
    images, y = images_and_noise(60, 5)
    folds = refit_features(Pixels(), images, y)
    alone = crossfit_forecast(Pixels(), images[:, [3, 1]], y)
    np.testing.assert_array_equal(forecast_from_folds(folds, y, columns=[3, 1]).rms, alone.rms)


def test_a_target_that_never_changes_has_no_error():
    images, _ = images_and_noise(40, 3)
    forecast = crossfit_forecast(Pixels(), images, np.full(40, 0.3))
    assert forecast.rms[0] == forecast.baseline[0] == 0


def test_too_few_folds_or_groups_are_refused():
    with pytest.raises(InvalidInputError, match="n_folds must be 2 or more"):
        cut_folds(np.zeros((20, 1)), None, n_folds=1)
    with pytest.raises(InvalidInputError, match="at least 4 groups"):
        cut_folds(np.zeros((20, 1)), np.zeros(20), n_folds=5)


@pytest.mark.parametrize(
    ("Y", "message"), [(np.full(20, np.nan), "y must be finite"), (np.zeros(30), "as many")]
)
def test_targets_that_do_not_fit_are_refused(Y, message):
    images, y = images_and_noise(20, 3)
    folds = refit_features(Pixels(), images, y)
    with pytest.raises(InvalidInputError, match=message):
        forecast_from_folds(folds, Y)
