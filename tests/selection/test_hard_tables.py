"""Forecasts and rankings at extreme scales, with repeated shots, and with values that are none."""

import numpy as np
import pytest

import servoscope as sv
from servoscope.errors import InvalidInputError
from servoscope.selection.candidates import Candidates
from servoscope.selection.criteria import CRITERIA
from servoscope.selection.forecast import Fold, cut_folds, forecast_errors, forecast_from_folds
from servoscope.selection.forward import forward_selection
from servoscope.selection.learning_curves import learning_curve

EXTREME = (1e-300, 1e-200, 1e-70, 1e70, 1e200, 1e300)


def in_folds(X, y):
    """The forecast of features that are the same in every fold."""
    parts = cut_folds(np.asarray(y)[:, None], None, 5)
    return forecast_from_folds([Fold(part, X) for part in parts], y)


def samples(n=60, seed=0, noise=0.1):
    rng = np.random.default_rng(seed)
    X = rng.uniform(-1, 1, (n, 4))
    return X, X[:, 2] + 0.5 * X[:, 0] ** 2 + noise * rng.normal(size=n)


@pytest.mark.parametrize("criterion", CRITERIA)
@pytest.mark.parametrize("scale", EXTREME)
def test_no_ranking_depends_on_the_scale(criterion, scale):
    X, y = samples()
    expected = sv.MutualInfoSelector(4, criterion).fit(X, y)
    for arguments in ((scale * X, y), (X, scale * y), (X * [1, scale, 1, 1 / scale], y)):
        found = sv.MutualInfoSelector(4, criterion).fit(*arguments)
        np.testing.assert_array_equal(found.ranking_, expected.ranking_)
        np.testing.assert_allclose(found.relevance_, expected.relevance_, atol=1e-6)


@pytest.mark.parametrize("scale", [1e-200, 1e200])
def test_forecasts_follow_the_unit_of_the_target_at_any_scale(scale):
    X, y = samples()
    plain = forecast_errors(X, y)
    for features in (X, scale * X):
        found = forecast_errors(features, scale * y)
        assert found.rms / scale == pytest.approx(plain.rms, rel=0.02)
        assert found.baseline / scale == pytest.approx(plain.baseline, rel=1e-6)
        assert found.interval / scale == pytest.approx(plain.interval, rel=0.02)
        assert found.explained == pytest.approx(plain.explained, abs=0.02)
    errors = forward_selection(X, scale * y, 2).errors / scale
    assert errors == pytest.approx(forward_selection(X, y, 2).errors, rel=0.02)
    folds = in_folds(X, scale * y).rms / scale
    assert folds == pytest.approx(in_folds(X, y).rms, rel=0.02)


def test_learning_curves_follow_the_unit_of_the_target():
    X, y = samples(48)
    plain, found = learning_curve(X, y), learning_curve(X, 1e200 * y)
    np.testing.assert_allclose(found.rms / 1e200, plain.rms, rtol=0.02)
    np.testing.assert_allclose(found.rms_at(200).rms / 1e200, plain.rms_at(200).rms, rtol=0.02)


@pytest.mark.parametrize("n_shots", [2, 5])
@pytest.mark.parametrize("jitter", [0.0, 1e-4, 1e-3])
@pytest.mark.parametrize("noise", [0.02, 0.3])
def test_repeated_shots_make_no_forecast_better_than_new_poses_are(n_shots, jitter, noise):
    """The noise is of the pose: all of its shots share it, and only other poses show it.

    Of so few poses the likelihood may have two maxima, and any jitter may move a forecast
    from one to the other: the mean of several is compared.
    """
    ratios = []
    for seed in range(5):
        X, y = samples(40, seed, noise)
        one = forecast_errors(X, y)
        often = np.repeat(X, n_shots, axis=0)
        often += jitter * np.random.default_rng(seed).normal(size=often.shape)
        many = forecast_errors(often, np.repeat(y, n_shots))
        widths = [np.log(found.interval[1] / found.interval[0]) for found in (many, one)]
        ratios.append([many.rms / one.rms, many.baseline / one.baseline, widths[0] / widths[1]])
    ratios = np.ravel(np.exp(np.mean(np.log(ratios), axis=0)))
    assert np.all(np.abs(ratios - 1) < [0.05, 0.05, 0.1]), ratios


def test_a_forecast_is_of_single_shots():
    """Each shot has noise of its own: the mean of five has less than a new one will have."""
    X, _ = samples(60)
    rng = np.random.default_rng(1)
    y = np.repeat(X[:, 2], 5) + 0.2 * rng.normal(size=300)
    assert forecast_errors(np.repeat(X, 5, axis=0), y).rms == pytest.approx([0.2], rel=0.15)


def test_parts_and_subsets_keep_the_shots_of_a_pose_together():
    X, y = samples(40, noise=0.3)
    X, y = np.repeat(X, 4, axis=0), np.repeat(y, 4)
    order = np.random.default_rng(0).permutation(160)
    X, y = X[order], y[order]
    spread = 0.3
    assert in_folds(X, y).rms[0] > 0.8 * spread
    curve = learning_curve(X, y)
    assert curve.rms.min() > 0.8 * spread
    assert forward_selection(X, y, 2).errors.min() > 0.7 * spread


def test_groups_given_are_kept_and_poses_are_not_divided_by_them():
    X, y = samples(40)
    X, y = np.tile(X, (2, 1)), np.tile(y, 2)
    groups = np.arange(80) // 8  # each pose is in two of these
    once = forecast_errors(X[:40], y[:40], groups=groups[:40])
    twice = forecast_errors(X, y, groups=groups)
    assert twice.rms == pytest.approx(once.rms, rel=0.1)


@pytest.mark.parametrize(
    "estimate",
    [
        sv.mutual_information,
        forecast_errors,
        learning_curve,
        forward_selection,
        lambda X, y: sv.MutualInfoSelector(2).fit(X, y),
        lambda X, y: sv.pairwise_mutual_information(np.ma.column_stack([X, y])),
        in_folds,
        Candidates,
    ],
)
def test_masked_values_are_refused(estimate):
    X, y = samples()
    for arguments in ((np.ma.masked_greater(X, 0.5), y), (X, np.ma.masked_greater(y, 0.5))):
        with pytest.raises(InvalidInputError, match=r"hides .* values behind a mask"):
            estimate(*arguments)


@pytest.mark.parametrize("estimate", [forecast_errors, forward_selection])
@pytest.mark.parametrize(
    "cast",
    [np.asfortranarray, lambda a: np.repeat(a, 2, axis=0)[::2], lambda a: a.astype(object)],
)
def test_how_numbers_are_kept_does_not_matter(estimate, cast):
    X, y = samples(40)
    expected, found = estimate(X, y), estimate(cast(X), cast(y))
    for one, other in zip(vars(expected).values(), vars(found).values(), strict=True):
        if isinstance(one, np.ndarray):
            np.testing.assert_array_equal(one, other)
