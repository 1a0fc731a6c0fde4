import cv2
import numpy as np
import pytest

import servoscope as sv
from servoscope.errors import InvalidInputError


@pytest.fixture(scope="module")
def moments(images):
    return sv.GradientMoments(n_cells=4).fit(images)


@pytest.mark.parametrize(("gain", "offset"), [(0.4, 0), (1, 60), (0.5, 33)])
def test_neither_gain_nor_offset_changes_anything(moments, images, gain, offset):
    np.testing.assert_allclose(
        moments.transform(gain * images.astype(float) + offset),
        moments.transform(images),
        atol=1e-4,
    )


@pytest.fixture(scope="module")
def textured():
    """An image of a pattern much finer than the cells."""
    pattern = cv2.GaussianBlur(np.random.default_rng(0).normal(size=(80, 80)), (0, 0), 1.5)
    return cv2.normalize(pattern, None, 50, 250, cv2.NORM_MINMAX)[None]


def test_a_light_that_falls_off_slowly_changes_little(textured):
    """By a third from one side of the view to the other; without normalisation it is more."""
    moments = sv.GradientMoments(n_cells=4).fit(textured)
    before = moments.transform(textured)
    after = moments.transform(textured * np.linspace(1, 2 / 3, 80))
    assert np.abs(after - before).mean() < 0.05 * before.mean()


def test_what_covers_a_corner_leaves_the_opposite_one_as_it_was(textured):
    covered = textured.copy()
    covered[:, :20, :20] = 90
    moments = sv.GradientMoments(n_cells=4).fit(textured)
    before, after = (moments.transform(i).reshape(8, 4, 4) for i in (textured, covered))
    changes = np.abs(after / after[:, 2:, 2:].mean() - before / before[:, 2:, 2:].mean())
    assert changes[:, 2:, 2:].mean() < changes[:, 0, 0].mean() / 20


@pytest.mark.parametrize("angle", range(0, 360, 45))
def test_a_ramp_has_slope_in_its_direction(angle):
    rows, columns = np.mgrid[:64, :64] - 31.5
    along = np.cos(np.radians(angle)) * columns + np.sin(np.radians(angle)) * rows
    moments = sv.GradientMoments(n_cells=1).set_output(transform="pandas")
    features = moments.fit_transform(128 + along[None]).iloc[0]
    assert features.idxmax() == f"o{angle:03d}_0_0"
    # A direction 45 degrees away has half of the energy, one further away has none.
    expected = np.sqrt([0.5, 0.25, 0.25, 0, 0, 0, 0, 0])
    np.testing.assert_allclose(np.sort(features)[::-1], expected, atol=0.08)


def test_an_edge_is_in_its_cell():
    image = np.zeros((1, 64, 64), np.uint8)
    image[:, :20, 36:] = 200
    moments = sv.GradientMoments(n_cells=4).fit(image)
    cells = moments.transform(image).reshape(8, 4, 4)
    assert np.unravel_index(cells[0].argmax(), (4, 4)) == (0, 2)
    assert cells[0, 3].max() < 0.05


def test_features_of_an_image_have_unit_length(moments, images):
    np.testing.assert_allclose(np.linalg.norm(moments.transform(images), axis=1), 1, rtol=1e-5)


@pytest.mark.parametrize("level", [0, 128, 255])
def test_an_image_without_anything_in_it_has_features_of_zeros(level):
    blank = np.full((1, 30, 40), level, np.uint8)
    assert (sv.GradientMoments().fit_transform(blank) == 0).all()


def test_cells_are_no_more_than_pixels_and_named_by_row_and_column(images):
    few = sv.GradientMoments(n_cells=5).fit(images[:, :3])
    names = few.get_feature_names_out()
    assert (few.n_rows_, few.n_columns_, len(names)) == (3, 5, 120)
    assert list(names[[0, 1, 5, 15]]) == ["o000_0_0", "o000_0_1", "o000_1_0", "o045_0_0"]


@pytest.mark.parametrize("wrong", [{"n_cells": 0}, {"n_cells": 2.5}, {"size": 0}, {"size": "big"}])
@pytest.mark.parametrize("family", [sv.GradientMoments, sv.IntensityMoments])
def test_parameters_that_are_no_whole_numbers_are_refused(family, images, wrong):
    with pytest.raises(InvalidInputError, match="must be a whole number from 1"):
        family(**wrong).fit(images)


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


def test_names_have_slice_row_and_column(images):
    names = sv.IntensityMoments(n_cells=2).fit(images).get_feature_names_out()
    assert list(names[[0, 1, 2, 4]]) == ["i010_0_0", "i010_0_1", "i010_1_0", "i030_0_0"]
