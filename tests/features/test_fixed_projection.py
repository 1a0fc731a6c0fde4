"""What the families promise that are the same for every set of images."""

import numpy as np
import pytest

import servoscope as sv
from servoscope.errors import InvalidInputError
from servoscope.features.fixed_projection import project_separably

FAMILIES = [
    sv.TchebichefMoments(),
    sv.CosineCoefficients(),
    sv.FourierFeatures(),
    sv.FourierFeatures(window="hann"),
    sv.ImageProjections(),
    sv.LogPolarFeatures(),
]
each_family = pytest.mark.parametrize("family", FAMILIES, ids=lambda f: type(f).__name__)


@each_family
def test_gain_of_an_image_does_not_matter(family, images):
    grey = images.astype(float)
    np.testing.assert_allclose(
        family.fit_transform(0.3 * grey), family.fit_transform(grey), atol=1e-13
    )


@each_family
def test_grey_levels_in_eight_bits_give_what_floats_do(family, images):
    exact = family.fit_transform(images.astype(float))
    np.testing.assert_allclose(family.fit_transform(images), exact, atol=3e-5)


@each_family
def test_black_image_has_features_of_zero(family, images):
    black = np.zeros((1, 30, 40), np.uint8)
    np.testing.assert_array_equal(family.fit(images).transform(black), 0)


@each_family
def test_images_of_one_grey_have_finite_features(family):
    grey = np.full((2, 30, 40), 255, np.uint8)
    assert np.isfinite(family.fit_transform(grey)).all()


@each_family
def test_features_do_not_depend_on_the_images_of_fit(family, images):
    own = family.fit(images).transform(images)
    np.testing.assert_array_equal(family.fit(images[:1]).transform(images), own)


@each_family
@pytest.mark.parametrize("image_shape", [(1, 1), (1, 7), (7, 1), (2, 2), (3, 50)])
def test_images_may_be_of_any_size(family, image_shape):
    images = np.random.default_rng(0).integers(1, 256, (4, *image_shape), dtype=np.uint8)
    features = family.fit_transform(images)
    assert np.isfinite(features).all()
    assert features.shape == (4, len(family.get_feature_names_out()))


@each_family
def test_families_have_twenty_to_sixty_features_by_default(family, images):
    assert 20 <= family.fit_transform(images).shape[1] <= 60


@pytest.mark.parametrize("dtype", [np.uint8, np.float64])
def test_separable_projections_are_sums_over_pixels(dtype):
    rng = np.random.default_rng(0)
    images = rng.integers(0, 256, (5, 6, 9)).astype(dtype)
    rows, columns = rng.normal(size=(3, 6)), rng.normal(size=(4, 9))
    lengths = np.sqrt((images.astype(float) ** 2).sum(axis=(1, 2)))
    expected = np.einsum("iy,nyx,jx->nij", rows, images.astype(float), columns)
    expected /= lengths[:, None, None]
    found = project_separably(images.reshape(5, -1), (6, 9), rows, columns)
    np.testing.assert_allclose(found, expected, atol=1e-5 if dtype == np.uint8 else 1e-14)


@pytest.mark.parametrize("family", FAMILIES[:2], ids=lambda f: type(f).__name__)
def test_functions_of_the_two_sides_are_orthonormal(family, images):
    every_pixel = np.eye(15 * 11).reshape(-1, 15, 11)
    projections = family.fit_transform(every_pixel)
    np.testing.assert_allclose(projections.T @ projections, np.eye(36), atol=1e-13)


@pytest.mark.parametrize("family", FAMILIES[:2], ids=lambda f: type(f).__name__)
def test_all_orders_together_hold_the_whole_image(family):
    images = np.random.default_rng(0).uniform(1, 255, (3, 4, 5))
    features = type(family)(order=7).fit_transform(images)
    assert features.shape == (3, 20)
    np.testing.assert_allclose(np.linalg.norm(features, axis=1), 1)


def test_orders_of_two_digits_have_names_that_can_be_told_apart(images):
    names = sv.TchebichefMoments(order=12).fit(images).get_feature_names_out()
    assert {"t_0000", "t_0111", "t_1101"} <= set(names)
    assert len(set(names)) == 91


@pytest.mark.parametrize(
    ("family", "message"),
    [
        (sv.TchebichefMoments(order=-1), "order must be a whole number from 0, got -1"),
        (sv.CosineCoefficients(order=2.5), "order must be a whole number from 0, got 2.5"),
        (sv.FourierFeatures(max_frequency=0), "max_frequency must be a whole number from 1, got 0"),
        (sv.FourierFeatures(window="box"), "window must be .*hann.*, got 'box'"),
        (sv.ImageProjections(n_angles=0), "n_angles must be a whole number from 1, got 0"),
        (sv.ImageProjections(n_coefficients="3"), "n_coefficients must be .* from 1, got '3'"),
    ],
)
def test_bad_parameters_are_refused(family, message, images):
    with pytest.raises(InvalidInputError, match=message):
        family.fit(images)
