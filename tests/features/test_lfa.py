import numpy as np
import pytest
from scipy.ndimage import correlate

import servoscope as sv
from servoscope.errors import InvalidInputError
from servoscope.features.lfa import brightest_separate, centre_weighted_mask, filter_centre_weighted


def test_mask_is_the_inverse_distance_to_its_centre():
    mask = centre_weighted_mask(12)
    assert mask.sum() == pytest.approx(1)
    assert mask[5, 5] / mask[0, 0] == pytest.approx(11)
    assert mask[6, 6] / mask[6, 11] == pytest.approx(np.hypot(5.5, 0.5) / np.hypot(0.5, 0.5))


@pytest.mark.parametrize("window", [4, 12])
@pytest.mark.parametrize("shape", [(30, 41), (1, 5), (40, 3)])
def test_filter_is_that_of_scipy(window, shape):
    image = np.random.default_rng(0).uniform(size=shape)
    expected = correlate(image, centre_weighted_mask(window), mode="constant")
    np.testing.assert_allclose(filter_centre_weighted(image, window), expected, atol=1e-12)


def test_bright_pixel_lights_the_subwindows_that_cover_it():
    image = np.zeros((20, 20))
    image[10, 10] = 1
    rows, columns = np.nonzero(filter_centre_weighted(image, 4) > 1e-12)
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (9, 12, 9, 12)


@pytest.mark.parametrize("window", [0, 5, 2.0, None])
def test_windows_without_a_centre_between_pixels_are_refused(window):
    with pytest.raises(InvalidInputError, match="even number of pixels from 2"):
        centre_weighted_mask(window)


def test_subwindows_do_not_overlap_and_get_no_brighter():
    image = np.random.default_rng(1).uniform(size=(60, 60))
    found = brightest_separate(image, 8, 12)
    distances = np.abs(found[:, None] - found).max(axis=2) + 99 * np.eye(8, dtype=int)
    assert distances.min() >= 12
    assert (np.diff(image[tuple(found.T)]) <= 0).all()
    assert image[tuple(found[0])] == image.max()


def test_too_many_subwindows_are_refused_with_both_numbers():
    with pytest.raises(InvalidInputError, match=r"12 separate subwindows .* only 4 were found"):
        brightest_separate(np.eye(24)[::-1] * 0, 12, 12)


@pytest.fixture(scope="module")
def lfa(images, delta_p):
    estimator = sv.LocalFeatureAnalysis(n_components=10, n_per_dof=3, window=8)
    return estimator.fit(images.astype(float), delta_p)


@pytest.fixture(scope="module")
def K(normalised):
    """The matrix of eq. 16, formed."""
    U, singular, _ = np.linalg.svd(normalised.T, full_matrices=False)
    E = U[:, :10]
    return E @ np.diag(1 / singular[:10]) @ E.T


def test_features_are_outputs_of_columns_of_the_explicit_matrix(lfa, K, images, normalised):
    rows, columns = lfa.locations_.reshape(-1, 2).T
    expected = normalised @ K[:, rows * 40 + columns]
    np.testing.assert_allclose(lfa.transform(images.astype(float)), expected, atol=1e-9)


def test_grey_images_give_nearly_the_same_features(lfa, images, delta_p):
    of_grey = sv.LocalFeatureAnalysis(10, n_per_dof=3, window=8).fit(images, delta_p)
    np.testing.assert_array_equal(of_grey.locations_, lfa.locations_)
    np.testing.assert_allclose(of_grey.transform(images), lfa.transform(images), atol=1e-4)


def test_covariance_is_that_of_the_explicit_outputs_scaled_to_one(lfa, K, normalised, delta_p):
    M = (K.T @ normalised.T) @ delta_p
    expected = (M / np.abs(M).max(axis=0)).T.reshape(6, 30, 40)
    np.testing.assert_allclose(lfa.covariance_, expected, atol=1e-9)


def test_locations_are_the_brightest_separate_subwindows_of_its_magnitude(lfa):
    for covariance, filtered, locations in zip(
        lfa.covariance_, lfa.filtered_, lfa.locations_, strict=True
    ):
        np.testing.assert_allclose(filtered, filter_centre_weighted(np.abs(covariance), 8))
        np.testing.assert_array_equal(locations, brightest_separate(filtered, 3, 8))


def test_receptive_field_is_a_column_of_the_explicit_matrix(lfa, K):
    np.testing.assert_allclose(lfa.receptive_field(7, 11).ravel(), K[:, 7 * 40 + 11], atol=1e-9)


def test_receptive_field_outside_the_image_is_refused(lfa):
    with pytest.raises(InvalidInputError, match=r"inside the image of 30 x 40 .* row 30"):
        lfa.receptive_field(30, 0)


def test_outputs_of_all_pixels_reconstruct_as_well_as_eigenfeatures(lfa, normalised):
    E, eigenvalues = lfa.basis_.components.T, lfa.basis_.eigenvalues
    fields = np.stack([lfa.receptive_field(r, c).ravel() for r in range(30) for c in range(40)])
    outputs = normalised @ fields.T
    from_outputs = outputs @ (E * np.sqrt(eigenvalues)) @ E.T
    from_eigenfeatures = normalised @ E @ E.T
    np.testing.assert_allclose(from_outputs, from_eigenfeatures, atol=1e-9)


def test_given_basis_gives_what_an_own_one_does(lfa, images, delta_p):
    basis = sv.compute_image_basis(images.astype(float), 20)
    shared = sv.LocalFeatureAnalysis(10, n_per_dof=3, window=8, basis=basis)
    np.testing.assert_allclose(
        shared.fit_transform(images.astype(float), delta_p),
        lfa.transform(images.astype(float)),
        atol=1e-8,
    )


def test_names_number_the_fields_of_each_dof(lfa, images, delta_p):
    names = lfa.get_feature_names_out()
    assert list(names[[0, 2, 3, 17]]) == ["lfa_tx_00", "lfa_tx_02", "lfa_ty_00", "lfa_rz_02"]
    one = sv.LocalFeatureAnalysis(5, n_per_dof=2, window=8).fit(images, delta_p[:, 0])
    assert list(one.get_feature_names_out()) == ["lfa_0_00", "lfa_0_01"]


def test_a_dof_that_never_moves_has_no_covariance_and_finite_features(images, delta_p):
    lfa = sv.LocalFeatureAnalysis(10, n_per_dof=3, window=8).fit(images, delta_p * [0] + [0] * 6)
    assert (lfa.covariance_ == 0).all()
    assert np.isfinite(lfa.transform(images)).all()


def test_image_without_room_for_the_subwindows_is_refused(images, delta_p):
    with pytest.raises(InvalidInputError, match="12 separate subwindows of 12 x 12 pixels"):
        sv.LocalFeatureAnalysis(n_components=10).fit(images[:, :12], delta_p)


def test_impossible_number_of_fields_is_refused(images, delta_p):
    with pytest.raises(InvalidInputError, match="n_per_dof must be a whole number from 1"):
        sv.LocalFeatureAnalysis(n_components=10, n_per_dof=0).fit(images, delta_p)


def test_features_are_projections_of_the_explicit_outputs_on_their_covariance(
    images, normalised, delta_p
):
    U, singular, _ = np.linalg.svd(normalised.T, full_matrices=False)
    K = U[:, :10] @ np.diag(1 / singular[:10]) @ U[:, :10].T
    outputs = normalised @ K
    expected = outputs @ (outputs.T @ delta_p)
    found = sv.LocalFeatureCovariance(10).fit_transform(images.astype(float), delta_p)
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_covariance_is_where_local_feature_analysis_finds_its_locations(images, delta_p):
    grey = images.astype(float)
    fields = sv.LocalFeatureAnalysis(10, n_per_dof=2, window=6).fit(grey, delta_p)
    outputs = np.stack([fields.receptive_field(r, c).ravel() for r in range(30) for c in range(40)])
    covariance = fields.covariance_.reshape(6, -1)
    found = sv.LocalFeatureCovariance(10).fit(grey, delta_p).components_
    scale = np.linalg.norm(found, axis=1) / np.linalg.norm(covariance @ outputs, axis=1)
    np.testing.assert_allclose(found, scale[:, None] * (covariance @ outputs), atol=1e-9)


def test_features_estimate_the_displacement_by_least_squares_on_eigenfeatures(images, delta_p):
    grey = images.astype(float)
    eigenfeatures = sv.Eigenfeatures(10).fit_transform(grey)
    centred = delta_p - delta_p.mean(axis=0)
    expected = eigenfeatures @ np.linalg.lstsq(eigenfeatures, centred, rcond=None)[0]
    found = sv.LocalFeatureCovariance(10).fit_transform(grey, delta_p)
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_brightness_of_an_image_does_not_matter(images, delta_p):
    covariance = sv.LocalFeatureCovariance(10).fit(images, delta_p)
    np.testing.assert_allclose(
        covariance.transform(0.3 * images), covariance.transform(images), atol=1e-4
    )


def test_covariance_of_a_given_basis_gives_what_an_own_one_does(images, delta_p):
    grey = images.astype(float)
    basis = sv.compute_image_basis(grey, 20)
    shared = sv.LocalFeatureCovariance(10, basis=basis).fit_transform(grey, delta_p)
    own = sv.LocalFeatureCovariance(10).fit_transform(grey, delta_p)
    np.testing.assert_allclose(shared, own, atol=1e-9)


def test_names_are_the_degrees_of_freedom_or_numbers(images, delta_p):
    six = sv.LocalFeatureCovariance(5).fit(images, delta_p).get_feature_names_out()
    one = sv.LocalFeatureCovariance(5).fit(images, delta_p[:, 0]).get_feature_names_out()
    assert list(six[[0, 5]]) == ["pclfa_tx", "pclfa_rz"]
    assert list(one) == ["pclfa_0"]
