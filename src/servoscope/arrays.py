"""Arrays from outside, made numbers or refused."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.errors import InvalidInputError

LARGEST = 1e30
"""Values may be as large as this, and columns vary by as little as its inverse: the squares of
their ratios are still numbers."""


def check_unmasked(values: Any, name: str) -> None:
    """Raise InvalidInputError if an array hides values behind a mask.

    NumPy drops the mask wherever a plain array is made of a masked one: what was hidden would
    count as if it were measured.

    Examples
    --------
    >>> check_unmasked(np.ma.masked_invalid([1.0, np.nan]), "X")
    Traceback (most recent call last):
    servoscope.errors.InvalidInputError: X hides 1 of 2 values behind a mask; drop those samples \
or fill the values in.
    """
    mask = np.ma.getmask(values)
    if mask is not np.ma.nomask and mask.any():
        raise InvalidInputError(
            f"{name} hides {np.count_nonzero(mask)} of {mask.size} values behind a mask; drop "
            "those samples or fill the values in."
        )


def as_numbers(values: ArrayLike, name: str) -> NDArray[np.float64]:
    """A contiguous array in double precision; its values may be NaN or infinite.

    What is not of booleans, integers, floats or objects that are such numbers, or is masked, is
    refused by the name.
    """
    check_unmasked(values, name)
    try:
        array = np.asarray(values)
        if array.dtype.kind not in "biufO":
            raise TypeError(f"they are of type {array.dtype}")
        if array.dtype.kind == "O" and any(
            isinstance(v, str | bytes | complex) for v in array.flat
        ):
            raise TypeError("some are text or complex")
        with np.errstate(over="ignore"):  # becomes infinite, which is for the caller to judge
            numbers: NDArray[np.float64] = np.ascontiguousarray(array, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InvalidInputError(f"{name} must be an array of numbers ({error}).") from error
    return numbers.reshape(array.shape)  # a single number stays one


def check_scale(values: NDArray[np.float64], name: str) -> None:
    """Raise InvalidInputError where numbers are so large or vary so little that squares are none.

    Parameters
    ----------
    values : ndarray of shape (n,) or (n, n_columns)
    """
    span = np.ptp(values, axis=0)
    if np.abs(values).max() > LARGEST or ((span > 0) & (span < 1 / LARGEST)).any():
        raise InvalidInputError(
            f"{name} must be at most {LARGEST:g} and vary by at least {1 / LARGEST:g}, got up to "
            f"{np.abs(values).max():.3g}; give it in another unit."
        )
