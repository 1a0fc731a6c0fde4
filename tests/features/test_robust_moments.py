import numpy as np
import pytest

import servoscope as sv
from servoscope.errors import InvalidInputError
from servoscope.features import robust_moments


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
