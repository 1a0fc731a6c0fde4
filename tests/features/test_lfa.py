import numpy as np
import pytest

import servoscope as sv
from servoscope.errors import InvalidInputError
from servoscope.features.local_maxima import brightest_separate, filter_centre_weighted


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
