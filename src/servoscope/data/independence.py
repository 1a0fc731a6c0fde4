"""Which images are independent of each other: the one place that every split and hold-out asks."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from servoscope.data.images import PoseImageSet
from servoscope.data.splits import LEAST_GROUPS, Split, deal_groups, split_images
from servoscope.dofs import mask_of
from servoscope.errors import InvalidInputError
from servoscope.kernels.repeats import find_repeats, whole_poses

N_GROUPS = 20
"""Into how many groups dependent images are put, if there are enough of them."""

STEP_RATIO, NEIGHBOUR_RATIO = 0.5, 0.3
"""Below these, images count as a sequence, or as taken from places that were visited again."""

LEAST_IMAGES = 60
"""Of so many, drawn at random, 45 are learned from and 15 tested on."""

LEAST_LEARNED = 40

LEAST_WITH_RENDERED = 20
"""Of fewer images there are too few even if images rendered by a keyframe join them."""

FARTHEST_APART = 0.1
"""Groups of dependent images differ by more than this share of the range in some dof, if most
images can be kept that far apart."""

REPEATED = 0.003
"""Images that differ by less than this share of the range in every dof are of one pose."""

_N_DISTANCES = 8
_LEAST_KEPT = 0.75
_LARGEST_GROUP = 1 / 3
_LEAST_SCALE = 0.15
_CHANCE_PAIRS = 0.1

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class IndependentGroups:
    """Groups of images that may be held out in turn.

    Parameters
    ----------
    kind : {"independent", "sequence", "revisited"}
        How the images depend on each other.
    labels : ndarray of shape (n_images,)
        Group of each image, from 0; -1 for images that belong to none, since they are near to
        images of several groups.
    distance : float
        Images of different groups are farther apart than this: the largest difference of a dof,
        in shares of its range.
    ratio : float
        What the kind was found by: 1 for independent images, near 0 for dependent ones.
    """

    kind: str
    labels: Indices
    distance: float
    ratio: float

    def dependent(self, images: Indices) -> Indices | None:
        """The labels, or None where each of some images is by itself.

        Parameters
        ----------
        images : ndarray
            Such as those that are learned from: only if some of these are of one group must a
            forecast from them leave groups out.
        """
        own = self.labels[images]
        return None if len(np.unique(own)) == len(own) else self.labels


_STANDS_STILL = 1e-3
"""A camera that moves by less, in units of its spread, takes another shot of the same pose."""

_MANY_PLACES = 2 * N_GROUPS
"""Of more places than these it is asked whether they are independent, not whether there are few."""


def independent_groups(data: PoseImageSet, n_groups: int | None = None) -> IndependentGroups:
    """Groups of images such that no image shows what an image of another group shows.

    Shots of one pose are one group, and each image of another pose is one. A sequence is cut into
    blocks of time, images from places that were visited again into clusters of poses. Blocks and
    clusters that share places are joined, and images that are still near to another group, such
    as the first frames after a cut, belong to none. Groups of these are `FARTHEST_APART`; where
    that would leave too few images or groups, half as far, and so on.

    Parameters
    ----------
    data : PoseImageSet
        Of which only the poses, and their times if known or else their order, are looked at. A
        set that says ``split="blocks"`` is a sequence whatever they are.
    n_groups : int, optional
        Put the groups together until there are so many, of about equal size.

    Returns
    -------
    IndependentGroups

    Raises
    ------
    InvalidInputError
        If there are fewer than `n_groups` groups.

    Notes
    -----
    A sequence is found by the ratio of the mean squared step from one image to the next to that
    of two images drawn at random (von Neumann): 1 for independent poses. Images in no order, but
    taken at few places or of a sequence that was shuffled, are found by the distance of each pose
    to its nearest neighbour, over the same after every coordinate was permuted by itself, or was
    drawn evenly where there is but one. Shots that follow each other from one pose count as one,
    and of more places than that many all shots of each.
    Coordinates are those of the displacements along their
    principal axes, in units of their spread; what hardly moves does not count.

    Examples
    --------
    >>> poses = np.tile(np.eye(4), (6, 1, 1))
    >>> poses[:, 0, 3] = 0.01, 0.02, 0.04, 0.01, 0.02, 0.04
    >>> data = PoseImageSet(np.zeros((6, 8, 8), np.uint8), poses, np.eye(4), np.eye(8, dtype="u1"))
    >>> independent_groups(data).labels
    array([0, 1, 2, 0, 1, 2])
    """
    poses = _whitened(data)
    times = np.arange(len(data)) if data.times is None else data.times
    order = np.argsort(times, kind="stable")
    steps = np.diff(poses[order], axis=0)
    moved = np.linalg.norm(steps, axis=1) > _STANDS_STILL
    steps, apart = steps[moved], poses[order][np.append(True, moved)]
    kind, ratio = "independent", float(np.mean(steps**2) / 2) if steps.size else 1.0
    if data.split == "blocks" or ratio < STEP_RATIO:
        kind = "sequence"
        blocks = np.empty(len(data), np.intp)
        blocks[order] = np.arange(len(data)) * min(N_GROUPS, len(data)) // len(data)
        labels, distance = _kept_apart(data, order, blocks)
    else:
        labels, distance = _places(data)
        if labels.max() >= _MANY_PLACES:
            apart = poses[np.unique(labels, return_index=True)[1]]
        nearest, expected = _nearest_neighbours(apart)
        if nearest < NEIGHBOUR_RATIO * expected:
            kind, ratio = "revisited", nearest / expected
            most = min(N_GROUPS, max(len(data) // 2, 1))
            clusters = _cluster(poses, most, NEIGHBOUR_RATIO * expected)
            labels, distance = _kept_apart(data, order, clusters)
    if n_groups is not None:
        labels = _dealt(labels if data.moves().any() else np.zeros_like(labels), n_groups)
    return IndependentGroups(kind, labels, distance, ratio)


def split_data(
    data: PoseImageSet, protocol: str = "honest", seed: int = 0, groups: Indices | None = None
) -> Split:
    """The images of a data set that train, decide and test: independent groups as a whole.

    Parameters
    ----------
    data : PoseImageSet
    protocol, seed
        See `split_images`.
    groups : ndarray of shape (n_images,), optional
        The labels of `independent_groups`, where they are known.

    Raises
    ------
    InvalidInputError
        If there are too few groups for three parts.
    """
    labels = independent_groups(data).labels if groups is None else groups
    return split_images(len(data), protocol, seed, labels)


def split_groups(data: PoseImageSet, groups: IndependentGroups, seed: int) -> Split:
    """The images of an assessment that train, validate and test."""
    if len(data) < LEAST_IMAGES:
        raise InvalidInputError(
            f"An assessment needs at least {LEAST_IMAGES} images to learn from and to test on, "
            f"got {len(data)}; take more."
        )
    split = split_data(data, "honest", seed, groups.labels)
    if len(split.learned) < LEAST_LEARNED:
        raise InvalidInputError(
            f"An assessment needs at least {LEAST_LEARNED} images to learn from and some to test "
            f"on; of these {len(data)}, which depend on each other ({groups.kind}), "
            f"{len(split.learned)} and {len(split.test)} are left. Take more."
        )
    return split


def check_enough_images(data: PoseImageSet) -> None:
    """Raise InvalidInputError if a data set has fewer than `LEAST_WITH_RENDERED` images."""
    if len(data) < LEAST_WITH_RENDERED:
        raise InvalidInputError(
            f"An assessment needs at least {LEAST_WITH_RENDERED} images, and {LEAST_IMAGES} where "
            f"no keyframe explains the view, got {len(data)}; take more."
        )


def mark_sequence(data: PoseImageSet) -> PoseImageSet:
    """The same data set, to be split by blocks if its poses show that it is a sequence."""
    is_sequence = independent_groups(data).kind == "sequence"
    return replace(data, split="blocks") if is_sequence else data


def _in_metres(data: PoseImageSet) -> Array:
    """Displacements, rotations by how far they carry the camera about the pivot."""
    return data.delta_p() * _lever(data)


def _lever(data: PoseImageSet) -> Array:
    return np.repeat([1.0, data.pivot or 1.0], 3)


def _in_ranges(data: PoseImageSet) -> tuple[Array, float]:
    """Displacements in shares of the range, and how much of it is covered, 1 at most.

    Dofs of small range, as of noise, count less.
    """
    sizes = np.where(mask_of(data.dofs), data.ranges() * _lever(data), 0.0)
    p = _in_metres(data) / np.maximum(sizes, max(_LEAST_SCALE * sizes.max(), 1e-9))
    return p, min(float(np.ptp(p, axis=0).max()), 1.0)


def _places(data: PoseImageSet) -> tuple[Indices, float]:
    """One group for each pose; of a set that never moves one for each image."""
    n = len(data)
    if not data.moves().any():
        return np.arange(n), 0.0
    p, covered = _in_ranges(data)
    extent = np.ptp(p, axis=0)
    p = p[:, extent > _LEAST_SCALE * extent.max()]
    distance = covered * min(REPEATED, (_CHANCE_PAIRS / n**2) ** (1 / p.shape[1]))
    i, j = KDTree(p).query_pairs(distance, p=np.inf, output_type="ndarray").T
    near = connected_components(coo_array((np.ones(len(i)), (i, j)), shape=(n, n)))[1]
    return whole_poses(find_repeats(p, p), near.astype(np.intp)), distance


def _kept_apart(data: PoseImageSet, order: Indices, units: Indices) -> tuple[Indices, float]:
    """Units joined where they share places, and how far apart they are; -1 for images between."""
    (p, covered), n = _in_ranges(data), len(data)
    tree, in_order = KDTree(p[order]), units[order]
    best, most = (np.zeros(n, np.intp), 0.0), 0.0
    for distance in covered * FARTHEST_APART * 0.5 ** np.arange(_N_DISTANCES):
        pairs = tree.query_pairs(distance, p=np.inf, output_type="ndarray")
        groups = _joined(in_order, pairs)
        i, j = pairs.T
        groups[np.maximum(i, j)[groups[i] != groups[j]]] = -1
        sizes = np.bincount(groups[groups >= 0])
        n_groups = np.count_nonzero(sizes)
        quality = min(
            sizes.sum() / (_LEAST_KEPT * n),
            n_groups / min(LEAST_GROUPS, n),
            _LARGEST_GROUP * n / max(sizes.max(initial=1), _LARGEST_GROUP * n),
        )
        if quality > most:
            labels = np.full(n, -1, np.intp)
            labels[order[groups >= 0]] = np.unique(groups[groups >= 0], return_inverse=True)[1]
            best, most = (labels, float(distance)), quality
        if quality >= 1:
            break
    return best


def _joined(units: Indices, pairs: Indices) -> Indices:
    """Clusters of units, one number an image: units are joined if half of one is near the other."""
    n_units = int(units.max()) + 1
    i, j = np.concatenate([pairs, pairs[:, ::-1]]).T
    across = units[i] != units[j]
    near, unit = np.divmod(np.unique(i[across] * n_units + units[j[across]]), n_units)
    shape = (n_units, n_units)
    counts = coo_array((np.ones(len(near)), (units[near], unit)), shape=shape)
    counts.sum_duplicates()
    is_joined = 2 * counts.data >= np.bincount(units)[counts.row]
    ends = counts.row[is_joined], counts.col[is_joined]
    links = coo_array((counts.data[is_joined], ends), shape=shape)
    return np.asarray(connected_components(links, directed=False)[1][units], dtype=np.intp)


def _dealt(labels: Indices, n_groups: int) -> Indices:
    n_found = int(labels.max(initial=-1)) + 1
    if n_found < n_groups:
        raise InvalidInputError(
            f"To hold some images out, they must be of at least {n_groups} different places, but "
            f"these {len(labels)} are of {n_found} that are far apart; take them at more poses."
        )
    return deal_groups(labels, n_groups)


def _whitened(data: PoseImageSet) -> Array:
    """Displacements along their principal axes, each in units of its own spread."""
    poses = _in_metres(data)[:, mask_of(data.dofs)]
    if not poses.size:
        return poses
    poses = (poses - poses.mean(axis=0)) / poses.std(axis=0)
    axes, spreads, _ = np.linalg.svd(poses, full_matrices=False)
    kept = spreads > 0.05 * spreads[0]
    return np.asarray(axes[:, kept] * np.sqrt(len(poses)))


def _nearest_neighbours(poses: Array) -> tuple[float, float]:
    """Distance to the nearest neighbour, and that of independent poses that spread as these do."""
    n_poses, n_axes = poses.shape
    if not n_axes:
        return 1.0, 1.0
    rng = np.random.default_rng(0)
    if n_axes == 1:
        drawn = rng.uniform(poses.min(), poses.max(), (n_poses, 1))
    else:
        drawn = np.column_stack([rng.permutation(column) for column in poses.T])
    return _nearest(poses), max(_nearest(drawn), 1e-6)


def _nearest(poses: Array) -> float:
    distances, _ = KDTree(poses).query(poses, k=2)
    return float(np.median(distances[:, 1]))


def _cluster(poses: Array, most: int, apart: float) -> Indices:
    """Groups of poses near each other: one for each place if there are few places, else `most`."""
    from sklearn.cluster import KMeans

    places = _first_at_each_place(poses, most, apart)
    start = poses[places] if len(places) <= most else "k-means++"
    clusters = KMeans(min(len(places), most), init=start, n_init=1, random_state=0)
    return np.asarray(clusters.fit_predict(poses), dtype=np.intp)


def _first_at_each_place(poses: Array, most: int, apart: float) -> list[int]:
    """Poses that are further than that from each other, and near to all others; some of many."""
    left, places = np.arange(len(poses)), list[int]()
    while left.size and len(places) <= most:
        places.append(int(left[0]))
        left = left[np.linalg.norm(poses[left] - poses[left[0]], axis=1) > apart]
    return places
