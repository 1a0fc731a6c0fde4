"""Cells that an image is divided into, and what lies in each of them."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import InvalidInputError

Floats = NDArray[np.float32]

_WIDTH = 0.6
"""Standard deviation of a cell's weights, in cells."""


def pool_in_cells(layers: Floats, n_cells: int) -> Floats:
    """Mean of each layer about each cell, by Gaussian weights.

    Parameters
    ----------
    layers : ndarray of shape (..., height, width), float32
    n_cells : int
        Cells along either side; no more than there are pixels.

    Returns
    -------
    ndarray of shape (..., n_rows, n_columns), float32

    Examples
    --------
    >>> pool_in_cells(np.ones((5, 12, 2), np.float32), n_cells=4).shape
    (5, 4, 2)
    """
    rows, columns = _weights(layers.shape[-2], n_cells), _weights(layers.shape[-1], n_cells)
    return np.asarray(rows @ layers @ columns.T, dtype=np.float32)


def check_n_cells(n_cells: int) -> None:
    """Raise `InvalidInputError` unless `n_cells` is a whole number from 1."""
    if not isinstance(n_cells, int | np.integer) or n_cells < 1:
        raise InvalidInputError(f"n_cells must be a whole number from 1, got {n_cells!r}.")


def cell_names(layers: list[str], n_rows: int, n_columns: int) -> list[str]:
    """Names of the cells of layers, in the order of their values flattened.

    Examples
    --------
    >>> cell_names(["a", "b"], n_rows=1, n_columns=2)
    ['a_0_0', 'a_0_1', 'b_0_0', 'b_0_1']
    """
    cells = [f"{row}_{column}" for row in range(n_rows) for column in range(n_columns)]
    return [f"{layer}_{cell}" for layer in layers for cell in cells]


@cache
def _weights(size: int, n_cells: int) -> Floats:
    """Weights of the pixels along a side for each of the cells along it."""
    n_cells = min(n_cells, size)
    centres = (np.arange(n_cells) + 0.5) * size / n_cells
    away = (np.arange(size) + 0.5 - centres[:, None]) / (_WIDTH * size / n_cells)
    weights = np.exp(-0.5 * away**2)
    return (weights / weights.sum(axis=1, keepdims=True)).astype(np.float32)
