"""Kernels compiled by numba."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """A decorator that compiles a function by numba, and keeps the result on disk where that can be
    done.

    Examples
    --------
    >>> @compiled(error_model="numpy")
    ... def inverse(x):
    ...     return 1.0 / x
    >>> inverse(0.0)
    inf
    """

    def decorate(function: Callable[..., Any]) -> Any:
        try:
            return njit(cache=True, **options)(function)
        except RuntimeError:  # neither beside the file nor in the user's own folders can be written
            return njit(**options)(function)

    return decorate
