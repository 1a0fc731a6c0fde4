"""Completion of values that vary in few directions, some places of which are wrong."""

import copy

import numpy as np
import pytest

from servoscope.features.robust_projection import fit_robust_projection

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
