"""Which images train, which decide, and which test."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.errors import InvalidInputError

PROTOCOLS = ("paper", "honest")
"""``"paper"`` decides on the test images, as published; ``"honest"`` on images kept for that."""

HONEST_FRACTIONS = (0.60, 0.15, 0.25)
"""Shares of training, validation and test images; the paper's 750 / 250 is the same 25 % test."""

Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Split:
    """Indices of the images that train, that decide (stop nets, pick subsets), and that test.

    Under the paper's protocol `validation` is `test` itself.
    """

    train: Indices
    validation: Indices
    test: Indices

    @property
    def learned(self) -> Indices:
        """Those that train and those that decide together, ascending."""
        return np.sort(np.concatenate([self.train, self.validation]))


def split_images(
    n_images: int,
    protocol: str = "honest",
    seed: int = 0,
    times: ArrayLike | None = None,
    n_blocks: int = 20,
    groups: ArrayLike | None = None,
) -> Split:
    """Split images for a protocol, at random or, when `times` are given, by blocks of time.

    Both protocols test on the same images for the same seed. By blocks, the images in order of
    time are cut into `n_blocks` runs of equal length; whole runs train, decide or test, and the
    last tenth of a run, one image at least, is left out where the next run serves another purpose,
    so that images next to each other do not leak.

    Parameters
    ----------
    n_images : int
    protocol : {"honest", "paper"}
        60 / 15 / 25 % to train, decide and test; or 75 / 25 % with the test images deciding.
    seed : int
    times : array of shape (n_images,), optional
        [s]; when given, the split is by blocks.
    n_blocks : int
    groups : array of shape (n_images,), optional
        Images of equal value, such as repeated shots of one pose, serve the same purpose; they
        count as one where images are drawn at random. Blocks of time are left as they are.

    Returns
    -------
    Split

    Raises
    ------
    InvalidInputError
        If the protocol is unknown, there are too few images or groups for three parts, or `times`
        are not one finite number an image, or `groups` not one value an image.

    Examples
    --------
    >>> split = split_images(1000, "honest")
    >>> len(split.train), len(split.validation), len(split.test)
    (600, 150, 250)
    """
    if protocol not in PROTOCOLS:
        raise InvalidInputError(
            f"protocol must be one of {', '.join(PROTOCOLS)}, got {protocol!r}."
        )
    if times is None and groups is not None:
        return _split_groups(np.asarray(groups), n_images, protocol, seed)
    least = 8 if times is None else 2 * n_blocks
    if n_images < least:
        raise InvalidInputError(
            f"Splitting into training, validation and test needs at least {least} images, "
            f"got {n_images}."
        )
    if times is None:
        train, validation, test = _split_at_random(n_images, seed)
    else:
        train, validation, test = _split_by_blocks(_checked(times, n_images), n_blocks, seed)
    if protocol == "paper":
        return Split(np.sort(np.concatenate([train, validation])), test, test)
    return Split(train, validation, test)


def _split_groups(groups: NDArray[Any], n_images: int, protocol: str, seed: int) -> Split:
    if groups.shape != (n_images,):
        raise InvalidInputError(
            f"groups must be {n_images} values, one an image, got the shape {groups.shape}."
        )
    _, first, members = np.unique(groups, return_index=True, return_inverse=True)
    order = np.argsort(np.argsort(first))[members]  # groups by their first images
    split = split_images(len(first), protocol, seed)
    train, validation, test = (
        np.flatnonzero(np.isin(order, part)) for part in (split.train, split.validation, split.test)
    )
    return Split(train, test if split.validation is split.test else validation, test)


def _checked(times: ArrayLike, n_images: int) -> NDArray[np.float64]:
    seconds = np.asarray(times, dtype=float)
    if seconds.shape != (n_images,) or not np.isfinite(seconds).all():
        raise InvalidInputError(
            f"times must be {n_images} finite numbers, one an image, got the shape "
            f"{seconds.shape} with {np.count_nonzero(~np.isfinite(seconds))} NaN or infinite."
        )
    return seconds


def _split_at_random(n: int, seed: int) -> tuple[Indices, Indices, Indices]:
    order = np.random.default_rng([seed, 1]).permutation(n)
    _, validation_share, test_share = HONEST_FRACTIONS
    n_validation, n_test = round(validation_share * n), round(test_share * n)
    parts = order[n_test + n_validation :], order[n_test : n_test + n_validation], order[:n_test]
    return np.sort(parts[0]), np.sort(parts[1]), np.sort(parts[2])


def _split_by_blocks(
    times: NDArray[np.float64], n_blocks: int, seed: int
) -> tuple[Indices, Indices, Indices]:
    purposes = np.zeros(n_blocks, dtype=int)
    _, validation_share, test_share = HONEST_FRACTIONS
    n_validation, n_test = round(validation_share * n_blocks), round(test_share * n_blocks)
    order = np.random.default_rng([seed, 2]).permutation(n_blocks)
    purposes[order[:n_test]] = 2
    purposes[order[n_test : n_test + n_validation]] = 1
    parts: tuple[list[Indices], ...] = ([], [], [])
    for i, block in enumerate(np.array_split(np.argsort(times, kind="stable"), n_blocks)):
        leaks = i + 1 < n_blocks and purposes[i] != purposes[i + 1]
        kept = block[: len(block) - max(1, len(block) // 10)] if leaks else block
        parts[purposes[i]].append(kept)
    train, validation, test = (np.sort(np.concatenate(part)) for part in parts)
    return train, validation, test
