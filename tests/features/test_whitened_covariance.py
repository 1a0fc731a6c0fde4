import numpy as np
import pytest
from sklearn.linear_model import Ridge

import servoscope as sv
from servoscope.errors import InvalidInputError


@pytest.mark.parametrize(("dtype", "tolerance"), [(np.uint8, 1e-3), (np.float64, 1e-10)])
def test_features_are_the_ridge_estimates_of_scikit_learn(
    images, normalised, delta_p, dtype, tolerance
):
    whitened = sv.WhitenedPoseCovariance(ridge=0.05)
    found = whitened.fit_transform(images.astype(dtype), delta_p) + delta_p.mean(axis=0)
    expected = Ridge(0.05 * (normalised**2).sum() / 59).fit(normalised, delta_p).predict(normalised)
    np.testing.assert_allclose(found, expected, atol=tolerance)


def test_features_of_products_are_ridge_estimates_of_them(images, normalised, delta_p):
    whitened = sv.WhitenedPoseCovariance(ridge=0.05, products=True)
    found = whitened.fit_transform(images.astype(float), delta_p)
    centred = delta_p - delta_p.mean(axis=0)
    product = centred[:, 1] * centred[:, 4]
    ridge = Ridge(0.05 * (normalised**2).sum() / 59).fit(normalised, product)
    column = list(whitened.get_feature_names_out()).index("pwi_ty_ry")
    np.testing.assert_allclose(
        found[:, column], ridge.predict(normalised) - product.mean(), atol=1e-9
    )
    assert found.shape == (60, 27)


def test_components_invert_the_interaction_matrix_of_images_linear_in_the_pose():
    """Under an isotropic sampling of poses, with the brightness of every image the same."""
    rng = np.random.default_rng(0)
    L, _ = np.linalg.qr(rng.normal(size=(200, 7)))
    unchanging, L = L[:, 0], L[:, 1:] * [1.0, 0.5, 2.0, 1.0, 3.0, 0.7]
    delta_p = np.vstack([np.eye(6), -np.eye(6)])
    varying = delta_p @ L.T
    rest = np.sqrt(25 - (varying**2).sum(axis=1, keepdims=True))
    images = varying + rest * unchanging
    whitened = sv.WhitenedPoseCovariance(ridge=1e-9).fit(images, delta_p)
    np.testing.assert_allclose(whitened.components_ @ L / 5, np.eye(6), atol=1e-6)


def test_a_large_ridge_gives_the_pose_image_covariance_but_for_scale(images, delta_p):
    found = sv.WhitenedPoseCovariance(ridge=1e8).fit_transform(images.astype(float), delta_p)
    covariance = sv.PoseImageCovariance().fit_transform(images.astype(float), delta_p)
    scale = np.linalg.norm(found) / np.linalg.norm(covariance)
    np.testing.assert_allclose(found, scale * covariance, rtol=1e-5, atol=1e-12)


def test_brightness_of_an_image_does_not_matter(images, delta_p):
    whitened = sv.WhitenedPoseCovariance().fit(images, delta_p)
    np.testing.assert_allclose(
        whitened.transform(0.3 * images), whitened.transform(images), atol=1e-4
    )


@pytest.mark.parametrize("dtype", [np.uint8, np.float64])
@pytest.mark.parametrize("factor", [0, 1])
def test_after_images_that_do_not_vary_features_are_zeros(images, delta_p, dtype, factor):
    same = np.repeat(factor * images[:1], 60, axis=0).astype(dtype)
    whitened = sv.WhitenedPoseCovariance().fit(same, delta_p)
    assert (whitened.transform(images.astype(dtype)) == 0).all()


@pytest.mark.parametrize("ridge", [0, -1.0, np.inf, np.nan, "much"])
def test_a_ridge_that_is_no_positive_number_is_refused(images, delta_p, ridge):
    with pytest.raises(InvalidInputError, match="ridge must be a positive number"):
        sv.WhitenedPoseCovariance(ridge=ridge).fit(images, delta_p)
