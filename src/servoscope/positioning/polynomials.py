"""Polynomials of a displacement, and their derivatives."""

from __future__ import annotations

from functools import lru_cache
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

HIGHEST_DEGREE = 4
"""The highest degree that a level may have: terms grow with its sixth power."""


@lru_cache(maxsize=8)
def exponents(degree: int) -> NDArray[np.int64]:
    """Exponents of every monomial of six variables up to a degree, (n_terms, 6); lowest first.

    Examples
    --------
    >>> [len(exponents(degree)) for degree in (1, 2, 3, 4)]
    [7, 28, 84, 210]
    """
    terms = [
        [term.count(dof) for dof in range(6)]
        for total in range(degree + 1)
        for term in combinations_with_replacement(range(6), total)
    ]
    return np.array(terms)


def evaluate_terms(powers: NDArray[np.int64], p: Array) -> Array:
    """Every monomial at displacements `p` of shape (..., 6), (..., n_terms).

    Parameters
    ----------
    powers : ndarray of shape (n_terms, 6)
        As `exponents` gives them.
    p : ndarray of shape (..., 6)

    Examples
    --------
    >>> evaluate_terms(exponents(1), np.arange(6.0))
    array([1., 0., 1., 2., 3., 4., 5.])
    """
    return np.prod(_power_table(powers, p)[..., np.arange(6), powers], axis=-1)


def differentiate_terms(powers: NDArray[np.int64], p: Array) -> Array:
    """Derivatives of every monomial at one displacement `p` of shape (6,), (6, n_terms)."""
    lowered = np.maximum(powers - np.eye(6, dtype=np.int64)[:, None], 0)
    values = np.prod(_power_table(powers, p)[np.arange(6), lowered], axis=-1)
    return powers.T * values


def _power_table(powers: NDArray[np.int64], p: Array) -> Array:
    """Each variable to each power, (..., 6, highest + 1)."""
    highest = int(powers.max())
    return np.asarray(p, dtype=float)[..., None] ** np.arange(highest + 1)
