import numpy as np
from scipy.fft import dctn

import servoscope as sv


def test_coefficients_are_those_of_scipy(images):
    normalised = images / np.linalg.norm(images.astype(float), axis=(1, 2), keepdims=True)
    expected = dctn(normalised, type=2, norm="ortho", axes=(1, 2))
    cosines = sv.CosineCoefficients(order=5).fit(images.astype(float))
    found = cosines.transform(images.astype(float))
    for name, column in zip(cosines.get_feature_names_out(), found.T, strict=True):
        i, j = int(name[-2]), int(name[-1])
        np.testing.assert_allclose(column, expected[:, j, i], atol=1e-14)


def test_orders_along_x_and_y_together_are_at_most_the_order(images):
    names = sv.CosineCoefficients(order=3).fit(images).get_feature_names_out()
    assert list(names) == [
        f"c_{ij}" for ij in ("00", "10", "01", "20", "11", "02", "30", "21", "12", "03")
    ]
