"""Which images train, which decide, and which test."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from servoscope.dataset import PoseImageSet
from servoscope.errors import InvalidInputError

PROTOCOLS = ("paper", "honest")
"""``"paper"`` decides on the test images, as published; ``"honest"`` on images kept for that."""

HONEST_FRACTIONS = (0.60, 0.15, 0.25)
"""Shares of training, validation and test images; the paper's 750 / 250 is the same 25 % test."""

FARTHEST_APART = 0.1
"""Images whose dofs differ by more than this share of the range count as independent."""

_N_DISTANCES = 8
_BLOCKS_PER_GROUP = 4
_LEAST_SHARE = 0.5

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


class IndependentGroups(NamedTuple):
    """Groups of images that may be held out in turn.

    Parameters
    ----------
    labels : ndarray of shape (n_images,)
        Group of each image, from 0; -1 for images that belong to none, since they are near to
        images of several groups.
    distance : float
        Images of different groups are farther apart than this: the largest difference of a dof,
        in shares of its range.
    """

    labels: Indices
    distance: float


def independent_groups(data: PoseImageSet, n_groups: int = 3) -> IndependentGroups:
    """Groups of images such that no image shows what an image of another group shows.

    Repeated shots of a pose are in one group. A sequence is cut into blocks of time; blocks that
    return to the same places are in one group. Images that are still near to another group, such
    as the first frames after a cut, belong to none. Groups are `FARTHEST_APART`; where that would
    leave too few images in one of them, half as far, and so on.

    Parameters
    ----------
    data : PoseImageSet
        A sequence if it says ``split="blocks"``, or if single images cannot be kept apart.
    n_groups : int

    Returns
    -------
    IndependentGroups

    Raises
    ------
    InvalidInputError
        If there are fewer than `n_groups` different places.

    Examples
    --------
    >>> poses = np.tile(np.eye(4), (6, 1, 1))
    >>> poses[:, 0, 3] = 0.01, 0.02, 0.03, 0.01, 0.02, 0.03
    >>> data = PoseImageSet(np.zeros((6, 8, 8), np.uint8), poses, np.eye(4), np.eye(8, dtype="u1"))
    >>> independent_groups(data).labels
    array([0, 1, 2, 0, 1, 2])
    """
    n = len(data)
    order = np.arange(n) if data.times is None else np.argsort(data.times, kind="stable")
    tree = KDTree((data.delta_p() / data.ranges())[order])
    n_blocks = min(_BLOCKS_PER_GROUP * n_groups, n)
    units = [np.arange(n) * n_blocks // n]
    if data.split != "blocks":
        units.insert(0, np.arange(n))
    some = None
    for distance in FARTHEST_APART * 0.5 ** np.arange(_N_DISTANCES):
        pairs = tree.query_pairs(distance, p=np.inf, output_type="ndarray")
        for unit in units:
            in_order = _dealt(_joined(unit, pairs), pairs, n_groups)
            least = np.bincount(in_order[in_order >= 0], minlength=n_groups).min()
            labels = np.empty(n, dtype=np.intp)
            labels[order] = in_order
            found = IndependentGroups(labels, float(distance))
            if least >= _LEAST_SHARE * n / n_groups:
                return found
            some = found if least else some
    if some is None:
        raise InvalidInputError(
            f"To hold some images out, they must be of at least {n_groups} different places, but "
            f"these {n} are all near to each other; take them at more poses."
        )
    return some


def _joined(units: Indices, pairs: Indices) -> Indices:
    """Clusters of units, one number an image: units are joined if half of one is near the other."""
    n_units = int(units.max()) + 1
    i, j = np.concatenate([pairs, pairs[:, ::-1]]).T
    across = units[i] != units[j]
    near = np.unique(np.column_stack([i, units[j]])[across], axis=0)
    shape = (n_units, n_units)
    counts = coo_array((np.ones(len(near)), (units[near[:, 0]], near[:, 1])), shape=shape)
    counts.sum_duplicates()
    is_joined = 2 * counts.data >= np.bincount(units)[counts.row]
    ends = counts.row[is_joined], counts.col[is_joined]
    links = coo_array((counts.data[is_joined], ends), shape=shape)
    return np.asarray(connected_components(links, directed=False)[1][units], dtype=np.intp)


def _dealt(clusters: Indices, pairs: Indices, n_groups: int) -> Indices:
    """A group for each image: clusters, largest first, each to the group with the fewest images."""
    sizes = np.bincount(clusters)
    group_of, filled = np.empty(len(sizes), dtype=np.intp), np.zeros(n_groups)
    for cluster in np.argsort(-sizes, kind="stable"):
        group_of[cluster] = np.argmin(filled)
        filled[group_of[cluster]] += sizes[cluster]
    labels = group_of[clusters]
    i, j = pairs.T
    labels[np.maximum(i, j)[labels[i] != labels[j]]] = -1
    return labels
