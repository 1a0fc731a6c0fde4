"""Vectors of three numbers in compiled kernels: tuples, so that none is made in memory."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(inline="always")
def row_of(rows, i):  # type: ignore[no-untyped-def]
    """A row of an array as a vector."""
    return rows[i, 0], rows[i, 1], rows[i, 2]


@njit(inline="always")
def plus(a, b):  # type: ignore[no-untyped-def]
    """The sum."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@njit(inline="always")
def minus(a, b):  # type: ignore[no-untyped-def]
    """The difference."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@njit(inline="always")
def dot(a, b):  # type: ignore[no-untyped-def]
    """The scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(inline="always")
def cross(a, b):  # type: ignore[no-untyped-def]
    """The vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(inline="always")
def turned(rotation, a):  # type: ignore[no-untyped-def]
    """The vector, turned by a matrix."""
    return dot(row_of(rotation, 0), a), dot(row_of(rotation, 1), a), dot(row_of(rotation, 2), a)


@njit(inline="always")
def of_length(a, length):  # type: ignore[no-untyped-def]
    """The vector, made as long as stated."""
    scale = length / np.sqrt(dot(a, a))
    return a[0] * scale, a[1] * scale, a[2] * scale


@njit(inline="always")
def blend(u, a, v, b, w, c):  # type: ignore[no-untyped-def]
    """The sum of three vectors, each times its weight."""
    return (
        u * a[0] + v * b[0] + w * c[0],
        u * a[1] + v * b[1] + w * c[1],
        u * a[2] + v * b[2] + w * c[2],
    )
