import numpy as np
import pytest

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
