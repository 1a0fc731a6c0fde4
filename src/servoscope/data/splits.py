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

LEAST_GROUPS = 8
"""Of fewer groups no three parts can be made."""

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
    n_images: int, protocol: str = "honest", seed: int = 0, groups: ArrayLike | None = None
) -> Split:
    """Split images for a protocol at random, groups of images as a whole.

    Both protocols test on the same images for the same seed. Groups are drawn one after another
    for the test part while that brings its size nearer to its share, then for the validation part;
    the rest trains.

    Parameters
    ----------
    n_images : int
    protocol : {"honest", "paper"}
        60 / 15 / 25 % to train, decide and test; or 75 / 25 % with the test images deciding.
    seed : int
    groups : array of shape (n_images,), optional
        Images of equal value serve the same purpose, see `independent_groups`; those of a value
        below 0 serve none. By default each image is by itself.

    Returns
    -------
    Split

    Raises
    ------
    InvalidInputError
        If the protocol is unknown, there are too few groups for three parts, or `groups` are not
        one value an image.

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
    labels = np.arange(n_images) if groups is None else np.asarray(groups)
    if labels.shape != (n_images,):
        raise InvalidInputError(
            f"groups must be {n_images} values, one an image, got the shape {labels.shape}."
        )
    members = _members(labels)
    if len(members) < LEAST_GROUPS:
        raise InvalidInputError(
            "Splitting into training, validation and test needs images from at least "
            f"{LEAST_GROUPS} places that are far apart, got {len(members)} of {n_images} images; "
            "take them at more poses."
        )
    drawn = [members[i] for i in np.random.default_rng([seed, 1]).permutation(len(members))]
    n = sum(map(len, members))
    test, validation = (_draw(drawn, round(share * n)) for share in HONEST_FRACTIONS[:0:-1])
    train = np.sort(np.concatenate(drawn))
    if protocol == "paper":
        return Split(np.sort(np.concatenate([train, validation])), test, test)
    return Split(train, validation, test)


def _members(labels: NDArray[Any]) -> list[Indices]:
    """The images of each group, groups in the order of their first images."""
    kept = np.flatnonzero(~(labels < 0)) if labels.dtype.kind == "i" else np.arange(len(labels))
    _, first, inverse = np.unique(labels[kept], return_index=True, return_inverse=True)
    order = np.argsort(inverse, kind="stable")
    found = np.split(kept[order], np.cumsum(np.bincount(inverse))[:-1])
    return [found[i] for i in np.argsort(first)]


def _draw(groups: list[Indices], n_wanted: int) -> Indices:
    """Take groups out of a list, in its order, while they bring their size nearer to a number."""
    size, taken = 0, []
    for i, group in enumerate(groups):
        if abs(size + len(group) - n_wanted) < n_wanted - size:
            size += len(group)
            taken.append(i)
    if not taken:
        taken = [int(np.argmin([len(group) for group in groups]))]
    part = np.sort(np.concatenate([groups[i] for i in taken]))
    for i in reversed(taken):
        del groups[i]
    return part
