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

MOST_IMAGES = 1500
"""What an assessment, or a model, is made of at most: time and memory grow with the square of the
number, and what more images add is forecast by the learning curve."""

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


def further_splits(split: Split, groups: Indices, seed: int = 0) -> list[Split]:
    """Splits that test on what a split learns from: every group of it once, between them.

    Parameters
    ----------
    split : Split
    groups : ndarray of shape (n_images,)
        As of `split_images`; no group is divided.
    seed : int
        Draws the images that decide.

    Returns
    -------
    list of Split
        Each tests on about as many images as the split does, and learns from all others, those
        that the split tests on among them.

    Examples
    --------
    >>> split = split_images(100)
    >>> others = further_splits(split, np.arange(100))
    >>> len(others), [len(other.learned) for other in others]
    (3, [75, 75, 75])
    >>> tested = np.concatenate([split.test, *(other.test for other in others)])
    >>> np.sort(tested).tolist() == list(range(100))
    True
    """
    learned = split.learned
    images = np.sort(np.concatenate([learned, split.test]))
    n_groups = len(np.unique(groups[learned]))
    n_parts = min(max(round(len(learned) / len(split.test)), 1), n_groups)
    _, own = np.unique(groups[learned], return_inverse=True)
    dealt = deal_groups(own, n_parts)
    splits = []
    for part in range(n_parts):
        test = learned[dealt == part]
        rest = np.setdiff1d(images, test)
        members = _members(groups[rest])
        order = np.random.default_rng([seed, 1, part]).permutation(len(members))
        drawn = [rest[members[i]] for i in order]
        validation = _draw(drawn, round(HONEST_FRACTIONS[1] * len(images)))
        splits.append(Split(np.sort(np.concatenate(drawn)), validation, test))
    return splits


def deal_groups(labels: Indices, n_parts: int) -> Indices:
    """Groups put together: the largest first, each to the part that has the fewest images.

    Parameters
    ----------
    labels : ndarray of shape (n_images,)
        Groups from 0, none of them empty; -1 for images of none.
    n_parts : int

    Returns
    -------
    ndarray of shape (n_images,)
        The part of each image; -1 where it is of no group.

    Examples
    --------
    >>> deal_groups(np.array([0, 0, 0, 1, 2, -1]), 2)
    array([ 0,  0,  0,  1,  1, -1])
    """
    sizes = np.bincount(labels[labels >= 0])
    dealt, filled = np.empty(len(sizes) + 1, dtype=np.intp), np.zeros(n_parts)
    for group in np.argsort(-sizes, kind="stable"):
        dealt[group] = np.argmin(filled)
        filled[dealt[group]] += sizes[group]
    dealt[-1] = -1
    return dealt[labels]


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
