import numpy as np
import pytest
from sklearn.decomposition import PCA

import servoscope as sv
from servoscope.errors import InvalidInputError


@pytest.mark.parametrize(("dtype", "tolerance"), [(np.uint8, 1e-5), (np.float64, 1e-12)])
def test_eigenfeatures_are_the_projections_of_scikit_learn_up_to_sign(
    images, normalised, dtype, tolerance
):
    found = sv.Eigenfeatures(10).fit_transform(images.astype(dtype))
    expected = PCA(10, svd_solver="full").fit_transform(normalised)
    expected *= np.sign(np.sum(found * expected, axis=0))
    np.testing.assert_allclose(found, expected, atol=tolerance)


def test_sum_of_squared_eigenfeatures_is_the_eigenvalue(images):
    eigenfeatures = sv.Eigenfeatures(10)
    found = eigenfeatures.fit_transform(images)
    np.testing.assert_allclose((found**2).sum(axis=0), eigenfeatures.eigenvalues_, rtol=1e-4)


def test_brightness_of_an_image_does_not_matter(images):
    eigenfeatures = sv.Eigenfeatures(5).fit(images)
    darker = images.astype(float) / 3
    np.testing.assert_allclose(
        eigenfeatures.transform(darker), eigenfeatures.transform(images), atol=1e-6
    )


def test_black_image_has_the_projection_of_minus_the_mean(images):
    eigenfeatures = sv.Eigenfeatures(5).fit(images)
    expected = -eigenfeatures.components_ @ eigenfeatures.mean_
    black = np.zeros((1, 30, 40), np.uint8)
    np.testing.assert_allclose(eigenfeatures.transform(black)[0], expected, atol=1e-6)


def test_given_basis_gives_what_an_own_one_does(images):
    basis = sv.compute_image_basis(images, 20)
    shared = sv.Eigenfeatures(8, basis=basis).fit(images[:2])
    own = sv.Eigenfeatures(8).fit(images)
    np.testing.assert_allclose(shared.transform(images), own.transform(images), atol=1e-4)
    assert shared.basis is basis
    assert np.shares_memory(shared.components_, basis.components)


def test_basis_of_images_of_another_size_is_refused_with_both_sizes(images):
    basis = sv.compute_image_basis(images, 5)
    with pytest.raises(InvalidInputError, match=r"of 30 x 40 .* images are of 30 x 39"):
        sv.Eigenfeatures(5, basis=basis).fit(images[:, :, 1:])


def test_names_count_from_zero(images):
    names = sv.Eigenfeatures(12).fit(images).get_feature_names_out()
    assert list(names[[0, 9, 11]]) == ["e_00", "e_09", "e_11"]
