import numpy as np
import pytest
from scipy.fft import dct
from skimage.transform import radon

import servoscope as sv


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


def test_names_tell_angle_and_coefficient(images):
    names = list(sv.ImageProjections(8, 2).fit(images).get_feature_names_out())
    assert names[:5] == ["p_sum", "p_0_1", "p_0_2", "p_22.5_1", "p_22.5_2"]
    assert len(names) == 17
