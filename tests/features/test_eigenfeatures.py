import copy
import pickle

import numpy as np
import pytest
from sklearn.decomposition import PCA

import servoscope as sv
from servoscope.errors import InvalidInputError
from servoscope.features import normalised_images


def test_basis_solves_the_eigenvalue_problem_of_the_covariance_matrix(images, normalised):
    basis = sv.compute_image_basis(images.astype(float), 10)
    C = normalised.T @ normalised
    np.testing.assert_allclose(
        basis.components @ C, basis.eigenvalues[:, None] * basis.components, atol=1e-12
    )
    np.testing.assert_allclose(basis.components @ basis.components.T, np.eye(10), atol=1e-10)
    assert (np.diff(basis.eigenvalues) < 0).all()


@pytest.mark.parametrize(("dtype", "tolerance"), [(np.uint8, 2e-4), (np.float64, 1e-9)])
def test_basis_is_that_of_scikit_learn_up_to_sign(images, normalised, dtype, tolerance):
    basis = sv.compute_image_basis(images.astype(dtype), 10)
    pca = PCA(10, svd_solver="full").fit(normalised)
    cosines = np.abs(np.sum(basis.components * pca.components_, axis=1))
    np.testing.assert_allclose(cosines, 1, atol=tolerance)
    np.testing.assert_allclose(
        basis.eigenvalues, pca.explained_variance_ * (len(images) - 1), rtol=1e-5
    )


def test_largest_entry_of_every_eigenvector_is_positive(images):
    basis = sv.compute_image_basis(images, 20)
    largest = np.abs(basis.components).argmax(axis=1)
    assert (basis.components[np.arange(20), largest] > 0).all()


def test_order_of_the_images_does_not_matter(images):
    basis = sv.compute_image_basis(images.astype(float), 10)
    reversed_basis = sv.compute_image_basis(images[::-1].astype(float), 10)
    np.testing.assert_allclose(reversed_basis.components, basis.components, atol=1e-9)


def test_runs_agree_bit_for_bit(images):
    first, second = (sv.compute_image_basis(images, 20) for _ in range(2))
    np.testing.assert_array_equal(first.components, second.components)
    np.testing.assert_array_equal(first.eigenvalues, second.eigenvalues)


def test_width_of_the_blocks_does_not_matter(images, monkeypatch):
    in_one = sv.compute_image_basis(images.astype(float), 10)
    monkeypatch.setattr(normalised_images, "BLOCK_ELEMENTS", 60 * 101)
    in_many = sv.compute_image_basis(images.astype(float), 10)
    np.testing.assert_allclose(in_many.components, in_one.components, atol=1e-10)


def test_leading_eigenvectors_share_memory_with_the_basis(images):
    basis = sv.compute_image_basis(images, 10)
    leading = basis.leading(4)
    assert len(leading) == 4
    assert np.shares_memory(leading.components, basis.components)
    np.testing.assert_array_equal(leading.eigenvalues, basis.eigenvalues[:4])


def test_copies_share_the_basis_and_it_cannot_be_changed(images):
    basis = sv.compute_image_basis(images, 3)
    assert copy.deepcopy(basis) is basis
    with pytest.raises(ValueError, match="read-only"):
        basis.components[0, 0] = 1


def test_basis_survives_the_way_to_another_process(images):
    basis = sv.compute_image_basis(images, 3)
    arrived = pickle.loads(pickle.dumps(basis))  # noqa: S301
    np.testing.assert_array_equal(arrived.components, basis.components)
    assert arrived.image_shape == (30, 40)


def test_too_few_images_are_refused_with_both_numbers(images):
    with pytest.raises(InvalidInputError, match="35 eigenvectors need at least 36 images, got 20"):
        sv.compute_image_basis(images[:20], 35)


@pytest.mark.parametrize("dtype", [np.uint8, np.float64])
def test_repeated_images_are_refused_with_both_numbers(images, dtype):
    repeated = np.tile(images[:10], (6, 1, 1)).astype(dtype)
    with pytest.raises(InvalidInputError, match=r"60 images.* have only 9 directions"):
        sv.compute_image_basis(repeated, 35)


@pytest.mark.parametrize("level", [0, 200])
def test_images_that_do_not_differ_are_refused(level):
    with pytest.raises(InvalidInputError, match="have only 0 directions"):
        sv.compute_image_basis(np.full((10, 8, 8), level, np.uint8), 2)


def test_more_eigenvectors_than_the_basis_has_are_refused_with_both_numbers(images):
    with pytest.raises(InvalidInputError, match="n_components is 9, but the basis has 5"):
        sv.compute_image_basis(images, 5).leading(9)


@pytest.mark.parametrize("n_components", [0, -1, 2.5, "all"])
def test_numbers_of_eigenvectors_that_make_no_sense_are_refused(images, n_components):
    with pytest.raises(InvalidInputError, match="whole number from 1"):
        sv.compute_image_basis(images, n_components)


def test_weak_eigenvectors_of_grey_images_are_kept_and_right():
    rng = np.random.default_rng(0)
    images = np.repeat(rng.integers(60, 200, (2, 64, 64)), 15, axis=0)
    images[:, 0, :30] += 20 * np.eye(30, dtype=int)
    basis = sv.compute_image_basis(images.astype(np.uint8), 20)
    exact = sv.compute_image_basis(images.astype(float), 20)
    assert basis.eigenvalues[-1] < 1e-5 * basis.eigenvalues[0]
    np.testing.assert_allclose(basis.eigenvalues, exact.eigenvalues, rtol=0.05)


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
