import numpy as np
import pytest
from numpy.polynomial import Polynomial

import servoscope as sv
from servoscope.features.tchebichef import tchebichef_polynomials


@pytest.mark.parametrize("n_points", [1, 2, 13, 20, 64, 255, 1024])
def test_polynomials_are_orthonormal_to_machine_precision(n_points):
    t = tchebichef_polynomials(min(13, n_points), n_points)
    np.testing.assert_allclose(t @ t.T, np.eye(len(t)), atol=4e-15)


def test_as_many_polynomials_as_points_are_still_orthonormal():
    t = tchebichef_polynomials(100, 100)
    np.testing.assert_allclose(t @ t.T, np.eye(100), atol=1e-14)


def test_polynomials_are_those_of_the_closed_form():
    # Mukundan, Ong and Lee (2001): t_2 and its squared length before normalisation.
    n_points = 9
    x = np.arange(n_points)
    quadratic = 6 * x**2 - 6 * (n_points - 1) * x + (n_points - 1) * (n_points - 2)
    squared_length = n_points * (n_points**2 - 1) * (n_points**2 - 4) / 5
    np.testing.assert_allclose(
        tchebichef_polynomials(3, n_points)[2], quadratic / np.sqrt(squared_length), atol=1e-15
    )


def test_polynomials_have_the_degree_of_their_number():
    x = np.linspace(-1, 1, 50)
    for degree, t in enumerate(tchebichef_polynomials(12, 50)):
        assert t[-1] > 0
        fit = Polynomial.fit(x, t, degree)
        np.testing.assert_allclose(fit(x), t, atol=1e-12)


def test_moments_of_low_order_hold_a_smooth_image():
    y, x = np.mgrid[:30, :40] / 40
    image = 1 + x - 0.5 * y * x**2 + y**3
    moments = sv.TchebichefMoments(order=3).fit(image[None])
    assert np.linalg.norm(moments.transform(image[None])) == pytest.approx(1, abs=1e-14)


def test_first_index_is_the_degree_along_x():
    ramp = np.tile(np.arange(10.0), (1, 8, 1))
    moments = sv.TchebichefMoments(order=2).set_output(transform="pandas").fit_transform(ramp)
    assert moments["t_10"].item() > 0.4
    assert abs(moments["t_01"].item()) < 1e-15
