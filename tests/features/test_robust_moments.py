import copy

import numpy as np
import pytest

import servoscope as sv
from servoscope.errors import InvalidInputError
from servoscope.features import robust_moments
from servoscope.features.robust_moments import fit_robust_projection

N_LAYERS, N_PLACES = 3, 40
NO_NUISANCE = np.zeros((0, N_LAYERS * N_PLACES))


def values_of(coefficients, seed=0):
    rng = np.random.default_rng(seed)
    directions = np.random.default_rng(9).normal(size=(5, N_LAYERS * N_PLACES))
    values = 4 + coefficients @ directions
    return values + 0.05 * rng.normal(size=values.shape)


@pytest.fixture(scope="module")
def training():
    return values_of(np.random.default_rng(1).normal(size=(200, 5)))


@pytest.fixture(scope="module")
def projection(training):
    return fit_robust_projection(training, N_LAYERS, 5, NO_NUISANCE)


@pytest.fixture(scope="module")
def fresh():
    return values_of(np.random.default_rng(2).normal(size=(30, 5)), seed=3)


@pytest.fixture(scope="module")
def spoilt(fresh):
    """A quarter of the places are all wrong, in all layers."""
    wrong = fresh.reshape(30, N_LAYERS, N_PLACES).copy()
    wrong[:, :, 5:15] = 9
    return wrong.reshape(30, -1)


SCALES = (100, 50, 20, 10, 5, 3, 3)


def test_places_that_are_wrong_are_completed_from_the_others(projection, fresh, spoilt):
    completed, weights = projection.complete(spoilt, SCALES)
    np.testing.assert_allclose(completed, fresh, atol=0.3)
    assert weights[:, 5:15].max() < 0.01
    assert np.median(weights) > 0.7


def test_a_plain_projection_is_taken_in_by_them(projection, fresh, spoilt):
    completed, _ = projection.complete(spoilt, (1e9,))
    assert np.abs(completed - fresh).mean() > 0.5


def test_with_all_places_in_play_it_is_the_projection_of_principal_components(
    training, projection, fresh
):
    completed, weights = projection.complete(fresh, (1e9,))
    centred = training - training.mean(axis=0)
    _, _, vectors = np.linalg.svd(centred, full_matrices=False)
    expected = training.mean(axis=0) + (fresh - training.mean(axis=0)) @ vectors[:5].T @ vectors[:5]
    np.testing.assert_allclose(completed, expected, atol=0.05)
    np.testing.assert_allclose(weights, 1, atol=1e-6)


def test_places_left_out_from_the_beginning_have_no_say(projection, fresh):
    weights = np.ones((30, N_PLACES))
    weights[:, 5:15] = 0
    changed = fresh.reshape(30, N_LAYERS, N_PLACES).copy()
    changed[:, :, 5:15] += 100
    completed, _ = projection.complete(changed.reshape(30, -1), (3,), weights)
    expected, _ = projection.complete(fresh, (3,), weights)
    np.testing.assert_allclose(completed, expected, atol=1e-9)


def test_a_common_factor_is_taken_out(projection, fresh):
    expected, _ = projection.complete(fresh, (1e9,))
    completed, _ = projection.complete(1.1 * fresh, (1e9,))
    np.testing.assert_allclose(completed, expected, atol=0.05)


def test_what_is_a_nuisance_is_no_change_of_what_values_show(training, fresh):
    nuisance = np.random.default_rng(5).normal(size=(1, N_LAYERS * N_PLACES))
    aware = fit_robust_projection(training, N_LAYERS, 5, nuisance)
    unaware = fit_robust_projection(training, N_LAYERS, 5, NO_NUISANCE)
    changed = fresh + 2 * nuisance
    errors = [np.abs(p.complete(changed, (1e9,))[0] - fresh).mean() for p in (aware, unaware)]
    assert errors[0] < 0.06
    assert errors[1] > 2 * errors[0]


def test_the_result_does_not_depend_on_what_else_is_completed(projection, spoilt):
    alone, _ = projection.complete(spoilt[7:8], SCALES)
    among, _ = projection.complete(np.concatenate([spoilt] * 3), SCALES)
    np.testing.assert_allclose(alone[0], among[37], atol=1e-9)


def test_values_that_never_vary_are_completed_with_themselves():
    same = np.full((10, N_LAYERS * N_PLACES), 2.0)
    projection = fit_robust_projection(same, N_LAYERS, 3, NO_NUISANCE)
    np.testing.assert_allclose(projection.complete(same, SCALES)[0], 2)


def test_what_follows_from_the_fields_is_not_copied_with_them(training, spoilt):
    projection = fit_robust_projection(training, N_LAYERS, 5, NO_NUISANCE)
    completed, _ = projection.complete(spoilt, SCALES)
    twin = copy.deepcopy(projection)
    assert len(vars(twin)) < len(vars(projection))
    np.testing.assert_array_equal(twin.complete(spoilt, SCALES)[0], completed)


@pytest.fixture(scope="module")
def covered(images):
    """An eighth of the view behind something grey, elsewhere in every image."""
    hidden, rng = images.copy(), np.random.default_rng(0)
    for image in hidden:
        row, column = rng.integers(0, 20), rng.integers(0, 25)
        image[row : row + 10, column : column + 15] = rng.integers(0, 255)
    return hidden


@pytest.fixture(scope="module")
def robust(images):
    return sv.RobustMoments(n_cells=4, n_fine_cells=10).fit(images)


def own_moments(images, n_cells=4, n_fine_cells=10):
    """Moments in the finer cells, and which of their rows and columns a coarser one is made of."""
    families = sv.GradientMoments(n_fine_cells), sv.IntensityMoments(n_fine_cells)
    moments = np.hstack([family.fit_transform(images) for family in families])
    return moments.reshape(len(images), 14, n_fine_cells, n_fine_cells)


def test_what_covers_a_part_of_the_view_changes_features_much_less_than_moments(
    robust, images, covered
):
    spread = robust.transform(images).std(axis=0).mean()
    change = np.abs(robust.transform(covered) - robust.transform(images)).mean()
    plain = own_moments(images)
    plain_change = np.abs(own_moments(covered) - plain).mean() / plain.std(axis=0).mean()
    assert change / spread < 0.5 * plain_change


def test_few_eigenvectors_first_keep_more_of_them_from_following_what_covers(
    images, covered, monkeypatch
):
    robust = sv.RobustMoments(n_cells=4, n_components=50, n_fine_cells=10).fit(images)
    expected = robust.transform(images)
    change = np.abs(robust.transform(covered) - expected).mean()
    monkeypatch.setattr(robust_moments, "_COARSE_SCALES", (1e9,))
    assert change < 0.95 * np.abs(robust.transform(covered) - expected).mean()


def test_what_is_white_may_change_intensities_only(robust):
    nuisances = robust.fine_.nuisances
    assert nuisances.shape == (4, 1400)
    assert (nuisances[:, :800] == 0).all()
    assert (np.abs(nuisances[:, 800:]).max(axis=1) > 0).all()


def test_of_an_image_as_in_training_they_are_nearly_its_own_moments(robust, images):
    features = robust.transform(images).reshape(60, 14, 4, 4)
    own = own_moments(images)
    corners = features[:, :, 0, 0], own[:, :, :3, :3].mean(axis=(2, 3))
    assert np.corrcoef(corners[0].ravel(), corners[1].ravel())[0, 1] > 0.98


def test_gain_changes_nothing(robust, images):
    darker = 0.8 * images.astype(float)
    np.testing.assert_allclose(robust.transform(darker), robust.transform(images), atol=2e-3)


def test_names_are_those_of_both_families(robust):
    names = list(robust.get_feature_names_out())
    of_gradient = sv.GradientMoments(4).fit(np.zeros((1, 30, 40))).get_feature_names_out()
    of_intensity = sv.IntensityMoments(4).fit(np.zeros((1, 30, 40))).get_feature_names_out()
    assert names == [*of_gradient, *of_intensity]


def test_images_that_do_not_vary_give_finite_features(images):
    same = np.repeat(images[:1], 10, axis=0)
    assert np.isfinite(sv.RobustMoments().fit_transform(same)).all()
    assert np.isfinite(sv.RobustMoments().fit_transform(0 * same)).all()


def test_too_few_images_and_impossible_numbers_are_refused(images):
    with pytest.raises(InvalidInputError, match="30 eigenvectors need at least 31 images, got 20"):
        sv.RobustMoments(n_components=30).fit(images[:20])
    for wrong in ({"n_cells": 0}, {"n_fine_cells": 0}, {"size": 0}, {"n_components": 0}):
        with pytest.raises(InvalidInputError, match="must be a whole number from 1"):
            sv.RobustMoments(**wrong).fit(images)
