import numpy as np
import pytest
from numpy.polynomial import Polynomial
from scipy.fft import dct
from skimage.transform import radon

import servoscope as sv
from servoscope.errors import InvalidInputError
from servoscope.features.fixed_projection import tchebichef_polynomials

FAMILIES = [
    sv.TchebichefMoments(),
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


def test_functions_of_the_two_sides_are_orthonormal():
    every_pixel = np.eye(15 * 11).reshape(-1, 15, 11)
    projections = sv.TchebichefMoments().fit_transform(every_pixel)
    np.testing.assert_allclose(projections.T @ projections, np.eye(36), atol=1e-13)


def test_all_orders_together_hold_the_whole_image():
    images = np.random.default_rng(0).uniform(1, 255, (3, 4, 5))
    features = sv.TchebichefMoments(order=7).fit_transform(images)
    assert features.shape == (3, 20)
    np.testing.assert_allclose(np.linalg.norm(features, axis=1), 1)


def test_orders_of_two_digits_have_distinct_names(images):
    names = sv.TchebichefMoments(order=12).fit(images).get_feature_names_out()
    assert {"t_0000", "t_0111", "t_1101"} <= set(names)
    assert len(set(names)) == 91


@pytest.mark.parametrize(
    ("family", "message"),
    [
        (sv.TchebichefMoments(order=-1), "order must be a whole number from 0, got -1"),
        (sv.ImageProjections(n_angles=0), "n_angles must be a whole number from 1, got 0"),
        (sv.ImageProjections(n_coefficients="3"), "n_coefficients must be .* from 1, got '3'"),
    ],
)
def test_bad_parameters_are_refused(family, message, images):
    with pytest.raises(InvalidInputError, match=message):
        family.fit(images)


@pytest.mark.parametrize("n_points", [1, 2, 13, 20, 64, 255, 1024])
def test_polynomials_are_orthonormal_to_machine_precision(n_points):
    t = tchebichef_polynomials(min(13, n_points), n_points)
    np.testing.assert_allclose(t @ t.T, np.eye(len(t)), atol=4e-15)


def test_as_many_polynomials_as_points_are_still_orthonormal():
    t = tchebichef_polynomials(100, 100)
    np.testing.assert_allclose(t @ t.T, np.eye(100), atol=1e-14)


def test_polynomials_are_those_of_the_closed_form():
    # Mukundan, Ong and Lee (2001): t_2 and its squared length before normalisation.
    n_points = 9
    x = np.arange(n_points)
    quadratic = 6 * x**2 - 6 * (n_points - 1) * x + (n_points - 1) * (n_points - 2)
    squared_length = n_points * (n_points**2 - 1) * (n_points**2 - 4) / 5
    np.testing.assert_allclose(
        tchebichef_polynomials(3, n_points)[2], quadratic / np.sqrt(squared_length), atol=1e-15
    )


def test_polynomials_have_the_degree_of_their_number():
    x = np.linspace(-1, 1, 50)
    for degree, t in enumerate(tchebichef_polynomials(12, 50)):
        assert t[-1] > 0
        fit = Polynomial.fit(x, t, degree)
        np.testing.assert_allclose(fit(x), t, atol=1e-12)


def test_moments_of_low_order_hold_a_smooth_image():
    y, x = np.mgrid[:30, :40] / 40
    image = 1 + x - 0.5 * y * x**2 + y**3
    moments = sv.TchebichefMoments(order=3).fit(image[None])
    assert np.linalg.norm(moments.transform(image[None])) == pytest.approx(1, abs=1e-14)


def test_first_index_is_the_degree_along_x():
    ramp = np.tile(np.arange(10.0), (1, 8, 1))
    moments = sv.TchebichefMoments(order=2).set_output(transform="pandas").fit_transform(ramp)
    assert moments["t_10"].item() > 0.4
    assert abs(moments["t_01"].item()) < 1e-15


def normalised(images):
    return images / np.linalg.norm(images.astype(float), axis=(1, 2), keepdims=True)


def test_first_and_right_angle_are_cosine_transforms_of_column_and_row_sums(images):
    height, width = images.shape[1:]
    projections = sv.ImageProjections(n_angles=2, n_coefficients=5).fit(images.astype(float))
    found = projections.transform(images.astype(float)) * np.sqrt(height * width)
    profiles = normalised(images).sum(axis=1), normalised(images).sum(axis=2)
    np.testing.assert_allclose(found[:, 0], profiles[0].sum(axis=1))
    for profile, columns in zip(profiles, (found[:, 1:6], found[:, 6:]), strict=True):
        np.testing.assert_allclose(columns, dct(profile, axis=1)[:, 1:6] / 2, atol=1e-12)


@pytest.mark.parametrize("i", range(6))
def test_profiles_are_those_of_a_radon_transform(i):
    side, n_coefficients = 101, 4
    y, x = np.indices((side, side)) - 50
    image = np.exp(-((x - 12) ** 2 + (y - 5) ** 2) / 60) + np.exp(-((x + 9) ** 2 + y**2) / 90)
    image[np.hypot(x, y) > 49] = 0  # scikit-image asks for it, of tails of 1e-7
    angle = 180 * i / 6
    # scikit-image counts angles against y downwards, and keeps the middle of a profile in it.
    profile = radon(image, theta=[-angle], circle=True)[:, 0]
    extent = side * (abs(np.cos(np.radians(angle))) + abs(np.sin(np.radians(angle))))
    along = 0.5 + (np.arange(side) - 50) / extent
    waves = np.cos(np.pi * np.outer(np.arange(1, n_coefficients + 1), along))
    expected = waves @ profile / np.linalg.norm(image) / side
    found = sv.ImageProjections(6, n_coefficients).fit_transform(image[None])[0, 1:]
    np.testing.assert_allclose(
        found.reshape(6, n_coefficients)[i], expected, atol=2e-3 * abs(expected).max()
    )


def test_names_have_angle_and_coefficient(images):
    names = list(sv.ImageProjections(8, 2).fit(images).get_feature_names_out())
    assert names[:5] == ["p_sum", "p_0_1", "p_0_2", "p_22.5_1", "p_22.5_2"]
    assert len(names) == 17


SIDE = 160
INNER_RADIUS = 1 / 16


def blobs(turned=0.0, enlarged=1.0):
    """Three smooth blobs in a ring about the centre, turned from x towards y and enlarged."""
    y, x = np.indices((SIDE, SIDE)) - (SIDE - 1) / 2
    image = np.zeros((SIDE, SIDE))
    for angle, radius, width in [(0.3, 28, 4), (2.1, 40, 5), (4.0, 22, 3)]:
        u = enlarged * radius * np.cos(angle + turned)
        v = enlarged * radius * np.sin(angle + turned)
        image += np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2 * (enlarged * width) ** 2))
    return image[None]


def spectrum(image):
    """Complex ``M(m, k)`` by (m, k)."""
    features = sv.LogPolarFeatures(4, 3, INNER_RADIUS).set_output(transform="pandas")
    row = features.fit_transform(image).iloc[0]
    pairs = [tuple(map(int, name.split("_")[2:])) for name in row.index if name[2] == "s"]
    return {(m, k): row[f"l_c_{m}_{k}"] + 1j * row[f"l_s_{m}_{k}"] for m, k in pairs}


@pytest.mark.parametrize("angle", [0.2, -1.0, np.pi / 2])
def test_turning_the_picture_turns_the_phases(angle):
    before, after = spectrum(blobs()), spectrum(blobs(turned=angle))
    for (m, k), value in before.items():
        assert after[m, k] == pytest.approx(value * np.exp(-1j * m * angle), abs=1e-5), (m, k)


@pytest.mark.parametrize("factor", [0.8, 1.1, 1.3])
def test_enlarging_the_picture_turns_the_phases_and_scales_the_magnitudes(factor):
    before, after = spectrum(blobs()), spectrum(blobs(enlarged=factor))
    turn = -2 * np.pi * np.log(factor) / np.log(1 / INNER_RADIUS)
    for (m, k), value in before.items():
        expected = factor * value * np.exp(1j * k * turn)
        assert after[m, k] == pytest.approx(expected, abs=1e-5), (m, k)


def test_a_quarter_turn_of_any_pixels_is_exact():
    image = np.random.default_rng(0).uniform(0, 255, (1, 33, 33))
    before, after = spectrum(image), spectrum(np.rot90(image, axes=(1, 2)))
    for (m, k), value in before.items():  # rot90 turns from y towards x
        assert after[m, k] == pytest.approx(value * 1j**m, abs=1e-13), (m, k)


def test_features_are_of_the_ring_only():
    image = np.random.default_rng(0).uniform(1, 255, (1, 40, 60))
    y, x = np.indices((40, 60))
    radius = np.hypot(x - 29.5, y - 19.5)
    ring = (radius < 20) & (radius >= 5)
    features = sv.LogPolarFeatures(inner_radius=0.25).fit(image)
    inside = features.components_.reshape(-1, 40, 60)[:, ring]
    outside = features.components_.reshape(-1, 40, 60)[:, ~ring]
    assert (outside == 0).all()
    assert (inside != 0).any(axis=0).all()
    np.testing.assert_allclose(features.components_[0].sum(), np.sqrt(np.count_nonzero(ring)))


@pytest.mark.parametrize("share", [0, 1, -0.5, np.nan])
def test_inner_radius_that_is_no_share_is_refused(share, images):
    with pytest.raises(InvalidInputError, match="inner_radius must be between 0 and 1, got"):
        sv.LogPolarFeatures(inner_radius=share).fit(images)
