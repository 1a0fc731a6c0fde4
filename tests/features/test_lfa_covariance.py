import numpy as np

import servoscope as sv


def test_features_are_projections_of_the_explicit_outputs_on_their_covariance(
    images, normalised, delta_p
):
    U, singular, _ = np.linalg.svd(normalised.T, full_matrices=False)
    K = U[:, :10] @ np.diag(1 / singular[:10]) @ U[:, :10].T
    outputs = normalised @ K
    expected = outputs @ (outputs.T @ delta_p)
    found = sv.LocalFeatureCovariance(10).fit_transform(images.astype(float), delta_p)
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_covariance_is_where_local_feature_analysis_looks_for_its_locations(images, delta_p):
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


def test_given_basis_gives_what_an_own_one_does(images, delta_p):
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
