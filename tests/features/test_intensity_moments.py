import numpy as np
import pytest

import servoscope as sv
from servoscope.errors import InvalidInputError


@pytest.mark.parametrize("gain", [0.3, 0.8, 2.0])
def test_gain_changes_nothing(images, gain):
    moments = sv.IntensityMoments(n_cells=4).fit(images)
    changed = gain * images.astype(float)
    np.testing.assert_allclose(moments.transform(changed), moments.transform(images), atol=1e-3)


def test_a_grey_level_counts_for_the_two_slices_nearest_to_it():
    """80 % of the image are white, 200; the left tenth is 0.66 of that, between 0.5 and 0.7."""
    image = np.full((1, 40, 100), 200.0)
    image[:, :, :30] = 0.66 * 200
    moments = sv.IntensityMoments(n_cells=20).set_output(transform="pandas")
    shares = moments.fit_transform(image).filter(like="_9_1").iloc[0] ** 2
    np.testing.assert_allclose(shares[["i050_9_1", "i070_9_1"]], [0.2, 0.8], atol=1e-3)
    assert shares[["i010_9_1", "i030_9_1", "i090_9_1", "i110_9_1"]].sum() < 1e-3


def test_shares_of_a_cell_sum_to_one(images):
    squares = sv.IntensityMoments(n_cells=4).fit_transform(images) ** 2
    np.testing.assert_allclose(squares.reshape(60, 6, 16).sum(axis=1), 1, rtol=1e-5)


def test_what_is_brighter_or_darker_than_all_levels_lies_in_the_outer_slices():
    image = np.full((1, 60, 60), 100.0)
    image[:, :6, :6], image[:, -6:, -6:] = 0, 250
    cells = sv.IntensityMoments(n_cells=20).fit_transform(image).reshape(6, 20, 20)
    np.testing.assert_allclose(cells[[0, 5], [0, 19], [0, 19]], 1, atol=0.03)


@pytest.mark.parametrize("level", [0, 128])
def test_an_image_without_anything_in_it_gives_finite_numbers(level):
    features = sv.IntensityMoments().fit_transform(np.full((1, 30, 40), level, np.uint8))
    assert np.isfinite(features).all()


def test_names_tell_slice_row_and_column(images):
    names = sv.IntensityMoments(n_cells=2).fit(images).get_feature_names_out()
    assert list(names[[0, 1, 2, 4]]) == ["i010_0_0", "i010_0_1", "i010_1_0", "i030_0_0"]


@pytest.mark.parametrize("wrong", [{"n_cells": -1}, {"size": 1.5}])
def test_parameters_that_are_no_whole_numbers_are_refused(images, wrong):
    with pytest.raises(InvalidInputError, match="must be a whole number from 1"):
        sv.IntensityMoments(**wrong).fit(images)
