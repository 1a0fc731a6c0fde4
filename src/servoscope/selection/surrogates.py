"""Rearrangements of the samples of a target that leave no relation to any feature."""

from __future__ import annotations

from collections.abc import Iterator
from numbers import Integral

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import InvalidInputError

REARRANGEMENTS = ("shuffle", "blocks", "shifts")
"""Single samples in a random order; blocks of them in a random order; the whole sequence turned."""


def rearrangements(
    n_samples: int,
    kind: str = "shuffle",
    n_permutations: int = 999,
    block_length: int | None = None,
    random_state: int = 0,
) -> Iterator[NDArray[np.intp]]:
    """Orders of the samples, one after the other.

    Parameters
    ----------
    n_samples : int
    kind : {"shuffle", "blocks", "shifts"}
        ``"shuffle"`` supposes independent samples. For sequences, ``"shifts"`` turns the whole
        sequence as a ring by a random number of samples, each number at most once, and so keeps
        all of its dependence but at the seam; ``"blocks"`` keeps it within blocks alone, which
        must be several times as long as the dependence.
    n_permutations : int
        How many orders. Of shifts there are ``n_samples - 1``, and no more come.
    block_length : int, optional
        Samples in a block, for ``"blocks"`` alone. The cuts begin at a random sample.
    random_state : int

    Yields
    ------
    ndarray of shape (n_samples,)

    Raises
    ------
    InvalidInputError
        If the kind is unknown, or a number does not fit it.

    Examples
    --------
    >>> next(rearrangements(6, "shifts", random_state=1))
    array([1, 2, 3, 4, 5, 0])
    """
    if kind not in REARRANGEMENTS:
        raise InvalidInputError(
            f"The rearrangement must be one of {', '.join(REARRANGEMENTS)}, got {kind!r}."
        )
    if not isinstance(n_permutations, Integral) or n_permutations < 1:
        raise InvalidInputError(f"n_permutations must be 1 or more, got {n_permutations!r}.")
    if kind == "blocks":
        check_block_length(block_length, n_samples)
    rng = np.random.default_rng(random_state)
    if kind == "shifts":
        return _shifts(n_samples, n_permutations, rng)
    length = 1 if block_length is None or kind == "shuffle" else block_length
    return (_shuffled_blocks(n_samples, length, rng) for _ in range(n_permutations))


def check_block_length(block_length: object, n_samples: int) -> None:
    """Raise InvalidInputError unless at least two blocks of this length fit in the samples."""
    if not isinstance(block_length, int | np.integer) or not 1 <= block_length <= max(
        n_samples // 2, 1
    ):
        raise InvalidInputError(
            f"block_length must be an integer from 1 to half of the {n_samples} samples, "
            f"got {block_length!r}."
        )


def _shifts(n_samples: int, n: int, rng: np.random.Generator) -> Iterator[NDArray[np.intp]]:
    for shift in 1 + rng.permutation(n_samples - 1)[:n]:
        yield np.roll(np.arange(n_samples), shift)


def _shuffled_blocks(n_samples: int, length: int, rng: np.random.Generator) -> NDArray[np.intp]:
    ring = (np.arange(n_samples) + rng.integers(n_samples)) % n_samples
    place = rng.permutation(-(-n_samples // length))
    return ring[np.argsort(place[np.arange(n_samples) // length], kind="stable")]
