"""Every monomial is there once, has its value, and its derivative."""

from math import comb

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from servoscope.positioning.polynomials import differentiate_terms, evaluate_terms, exponents

DEGREES = st.integers(1, 4)
displacements = arrays(float, 6, elements=st.floats(-1.5, 1.5))


@pytest.mark.parametrize("degree", range(5))
def test_there_is_every_monomial_once_and_lowest_first(degree) -> None:
    powers = exponents(degree)
    assert len({tuple(term) for term in powers.tolist()}) == len(powers) == comb(6 + degree, 6)
    totals = powers.sum(axis=1)
    assert totals[0] == 0
    assert totals.max() == degree
    assert (np.diff(totals) >= 0).all()


@pytest.mark.parametrize("degree", range(1, 5))
def test_the_linear_terms_are_in_the_order_of_the_dofs(degree) -> None:
    np.testing.assert_array_equal(exponents(degree)[1:7], np.eye(6))


@given(DEGREES, displacements)
def test_values_are_products_of_powers(degree, p) -> None:
    powers = exponents(degree)
    expected = [np.prod([x ** int(n) for x, n in zip(p, term, strict=True)]) for term in powers]
    np.testing.assert_allclose(evaluate_terms(powers, p), expected, rtol=1e-12, atol=1e-15)


@given(DEGREES, displacements)
def test_derivatives_are_those_of_finite_differences(degree, p) -> None:
    powers, h = exponents(degree), 1e-5
    ahead, behind = (evaluate_terms(powers, p + sign * h * np.eye(6)) for sign in (1, -1))
    np.testing.assert_allclose(
        differentiate_terms(powers, p), (ahead - behind) / (2 * h), rtol=1e-6, atol=1e-8
    )


def test_many_displacements_are_evaluated_at_once(rng) -> None:
    powers, p = exponents(3), rng.uniform(-1, 1, (4, 5, 6))
    values = evaluate_terms(powers, p)
    assert values.shape == (4, 5, 84)
    np.testing.assert_array_equal(values[2, 3], evaluate_terms(powers, p[2, 3]))
