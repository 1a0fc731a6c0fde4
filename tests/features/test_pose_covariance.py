import numpy as np
import pytest
from sklearn.cross_decomposition import PLSRegression

import servoscope as sv
from servoscope.errors import InvalidInputError


@pytest.mark.parametrize(("dtype", "tolerance"), [(np.uint8, 1e-6), (np.float64, 1e-14)])
def test_vectors_are_sums_over_images_of_displacement_times_image(
    images, normalised, delta_p, dtype, tolerance
):
    expected = np.zeros((6, 1200))
    for image, displacement in zip(normalised, delta_p, strict=True):
        for dof in range(6):
            expected[dof] += displacement[dof] * image
    pci = sv.PoseImageCovariance().fit(images.astype(dtype), delta_p)
    np.testing.assert_allclose(pci.components_, expected, atol=tolerance)
    np.testing.assert_allclose(
        pci.transform(images.astype(dtype)), normalised @ expected.T, atol=10 * tolerance
    )


def test_centring_the_displacements_changes_nothing(images, delta_p):
    as_given = sv.PoseImageCovariance().fit(images.astype(float), delta_p)
    shifted = sv.PoseImageCovariance().fit(images.astype(float), delta_p + 3)
    np.testing.assert_allclose(shifted.components_, as_given.components_, atol=1e-12)


def test_feature_of_a_dof_covaries_with_it(images, delta_p):
    features = sv.PoseImageCovariance().fit_transform(images, delta_p)
    products = (features - features.mean(axis=0)).T @ delta_p
    assert (np.diag(products) > 0).all()


def test_a_dof_that_never_moves_has_a_feature_of_zeros(images, delta_p):
    still = delta_p * [1, 1, 0, 1, 1, 1]
    features = sv.PoseImageCovariance().fit_transform(images, still)
    assert (features[:, 2] == 0).all()


def test_names_are_the_degrees_of_freedom_or_numbers(images, delta_p):
    six = sv.PoseImageCovariance().fit(images, delta_p).get_feature_names_out()
    two = sv.PoseImageCovariance().fit(images, delta_p[:, :2]).get_feature_names_out()
    assert list(six) == ["pci_tx", "pci_ty", "pci_tz", "pci_rx", "pci_ry", "pci_rz"]
    assert list(two) == ["pci_0", "pci_1"]


def test_missing_displacements_are_refused(images, delta_p):
    with pytest.raises(InvalidInputError, match="requires y"):
        sv.PoseImageCovariance().fit(images, None)
    with pytest.raises(InvalidInputError, match="inconsistent numbers of samples"):
        sv.PoseImageCovariance().fit(images, delta_p[:-1])


def test_displacements_that_are_not_finite_are_refused(images, delta_p):
    broken = delta_p.copy()
    broken[4, 2] = np.nan
    with pytest.raises(InvalidInputError, match="y contains NaN"):
        sv.PoseImageCovariance().fit(images, broken)


@pytest.mark.parametrize(("dtype", "tolerance"), [(np.uint8, 1e-4), (np.float64, 1e-9)])
def test_features_of_one_target_are_the_scores_of_scikit_learn_but_for_scale(
    images, normalised, delta_p, dtype, tolerance
):
    pls = sv.PoseLeastSquares(6, products=False)
    found = pls.fit_transform(images.astype(dtype), delta_p[:, 0])
    expected = PLSRegression(6, scale=False).fit(normalised, delta_p[:, 0]).x_scores_
    cosines = (found * expected).sum(axis=0)
    cosines /= np.linalg.norm(found, axis=0) * np.linalg.norm(expected, axis=0)
    np.testing.assert_allclose(np.abs(cosines), 1, atol=tolerance)


def test_first_direction_covaries_most_with_the_displacements(images, normalised, delta_p):
    standardised = (delta_p - delta_p.mean(axis=0)) / delta_p.std(axis=0)
    U, _, _ = np.linalg.svd(normalised.T @ standardised, full_matrices=False)
    pls = sv.PoseLeastSquares(1, products=False).fit(images.astype(float), delta_p)
    np.testing.assert_allclose(np.abs(pls.components_[0] @ U[:, 0]), 1, atol=1e-12)


def test_features_are_uncorrelated_and_directions_of_unit_length(images, delta_p):
    pls = sv.PoseLeastSquares(15)
    features = pls.fit_transform(images.astype(float), delta_p)
    np.testing.assert_allclose(np.corrcoef(features.T), np.eye(15), atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(pls.components_, axis=1), 1)


def test_units_of_the_displacements_do_not_matter(images, delta_p):
    grey, in_units = images.astype(float), delta_p * [1e-3, 1e-3, 1e-3, 1, 1, 57.3]
    np.testing.assert_allclose(
        sv.PoseLeastSquares(8).fit_transform(grey, in_units),
        sv.PoseLeastSquares(8).fit_transform(grey, delta_p),
        atol=1e-9,
    )


def test_regression_on_the_features_is_that_on_the_images_once_there_are_all_directions(
    images, normalised, delta_p
):
    features = sv.PoseLeastSquares(59).fit_transform(images.astype(float), delta_p)
    centred = delta_p - delta_p.mean(axis=0)
    fit = features @ np.linalg.lstsq(features, centred, rcond=None)[0]
    np.testing.assert_allclose(fit, centred, atol=1e-6)


def test_products_bring_what_is_of_second_order(delta_p):
    """Here one pixel changes with the square of the displacement, and nothing with itself."""
    rng = np.random.default_rng(0)
    there_and_back = np.concatenate([delta_p[:, :1], -delta_p[:, :1]])
    images = np.full((120, 50), 100.0) + 0.01 * rng.normal(size=(120, 50))
    images[:, 7] += there_and_back[:, 0] ** 2
    on_pixel = {
        products: sv.PoseLeastSquares(1, products).fit(images, there_and_back).components_[0, 7]
        for products in (False, True)
    }
    assert abs(on_pixel[True]) > 0.98
    assert abs(on_pixel[False]) < 0.8


def test_brightness_of_an_image_does_not_matter(images, delta_p):
    pls = sv.PoseLeastSquares(10).fit(images, delta_p)
    np.testing.assert_allclose(pls.transform(0.3 * images), pls.transform(images), atol=1e-5)


def test_a_dof_that_never_moves_has_no_say(images, delta_p):
    still = delta_p.copy()
    still[:, 2] = 0.1
    of_five = np.delete(delta_p, 2, axis=1)
    np.testing.assert_allclose(
        sv.PoseLeastSquares(8).fit_transform(images.astype(float), still),
        sv.PoseLeastSquares(8).fit_transform(images.astype(float), of_five),
        atol=1e-9,
    )


def test_more_directions_than_covary_are_refused(images, delta_p):
    with pytest.raises(InvalidInputError, match="60 directions that covary"):
        sv.PoseLeastSquares(60).fit(images, delta_p)
    with pytest.raises(InvalidInputError, match="there are only 0"):
        sv.PoseLeastSquares(1).fit(images, 0 * delta_p)
    with pytest.raises(InvalidInputError, match="there are only 0"):
        sv.PoseLeastSquares(1).fit(np.repeat(images[:1], 60, axis=0), delta_p)
    with pytest.raises(InvalidInputError, match="whole number from 1"):
        sv.PoseLeastSquares(0).fit(images, delta_p)
