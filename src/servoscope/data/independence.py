"""Whether images are independent of each other, and which ones have to be kept together."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree
from sklearn.cluster import KMeans

from servoscope.data.images import PoseImageSet
from servoscope.data.splits import Split, split_images
from servoscope.errors import InvalidInputError

N_GROUPS = 20
"""Into how many groups dependent images are put, if there are enough of them."""

STEP_RATIO, NEIGHBOUR_RATIO = 0.5, 0.3
"""Below these, images count as a sequence, or as taken from places that were visited again."""

LEAST_IMAGES = 60
"""Of so many, drawn at random, 45 are learned from and 15 tested on."""

LEAST_LEARNED = 40

LEAST_PLACES = 8
"""Of fewer places there is none to test on that is not learned from."""

_HARDLY_MOVES = 1e-3
"""Motion of so small a share of the largest is that of encoders, not of the camera."""

FARTHEST_APART = 0.1
"""Images whose dofs differ by more than this share of the range count as independent."""

_N_DISTANCES = 8
_BLOCKS_PER_GROUP = 4
_LEAST_SHARE = 0.5

Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Independence:
    """How images depend on each other.

    Parameters
    ----------
    kind : {"independent", "sequence", "revisited"}
    groups : ndarray of shape (n_images,)
        Images of one group must not be both learned from and tested on. Even where most images
        are independent, those from the very same pose make one group.
    ratio : float
        What was measured: 1 for independent images, near 0 for dependent ones.
    """

    kind: str
    groups: Indices
    ratio: float


def find_groups(data: PoseImageSet) -> Independence:
    """Find out whether the images of a data set are independent of each other.

    Parameters
    ----------
    data : PoseImageSet
        Of which it only looks at the poses, their times if known, or else their order. A set
        that says ``split="blocks"`` is a sequence whatever they look like.

    Notes
    -----
    A sequence is told by the ratio of the mean squared step from one image to the next to that
    of two images drawn at random (von Neumann): 1 for independent poses. Images in no order, but
    taken at few places or of a sequence that was shuffled, are told by the distance of each pose
    to its nearest neighbour, over the same after every coordinate was permuted by itself, or was
    drawn evenly where there is but one. Coordinates are those of the displacements along their
    principal axes, in units of their spread; what hardly moves does not count.
    """
    poses = _whitened(data)
    times = np.arange(len(data)) if data.times is None else data.times
    order = np.argsort(times, kind="stable")
    steps = np.diff(poses[order], axis=0)
    step_ratio = float(np.mean(steps**2) / 2) if steps.size else 1.0
    n_groups = min(N_GROUPS, max(len(data) // 2, 1))
    if data.split == "blocks" or step_ratio < STEP_RATIO:
        groups = np.empty(len(data), np.intp)
        for group, images in enumerate(np.array_split(order, n_groups)):
            groups[images] = group
        return Independence("sequence", groups, step_ratio)
    nearest, expected = _nearest_neighbours(poses)
    if nearest < NEIGHBOUR_RATIO * expected:
        clusters = _cluster(poses, n_groups, NEIGHBOUR_RATIO * expected)
        return Independence("revisited", clusters, nearest / expected)
    return Independence("independent", same_poses(data), step_ratio)


def mark_sequence(data: PoseImageSet) -> PoseImageSet:
    """The same data set, to be split by blocks if its poses show that it is a sequence."""
    is_sequence = find_groups(data).kind == "sequence"
    return replace(data, split="blocks") if is_sequence else data


def split_groups(data: PoseImageSet, independence: Independence, seed: int) -> Split:
    """Images that train, that validate and that test, with no group in two of these parts.

    Raises
    ------
    InvalidInputError
        If there are fewer than `LEAST_IMAGES` images, or too few are left to learn from.
    """
    check_enough_images(data)
    split = _split(data, independence, seed)
    n_learned = len(split.train) + len(split.validation)
    if n_learned < LEAST_LEARNED or not len(split.test):
        raise InvalidInputError(
            f"An assessment needs at least {LEAST_LEARNED} images to learn from and some to test "
            f"on; of these {len(data)}, which depend on each other ({independence.kind}), "
            f"{n_learned} and {len(split.test)} are left. Take more."
        )
    return split


def _split(data: PoseImageSet, independence: Independence, seed: int) -> Split:
    if independence.kind == "sequence":
        times = np.arange(len(data)) if data.times is None else data.times
        return split_images(len(data), "honest", seed, times)
    names = np.unique(independence.groups)
    if len(names) == len(data):
        return split_images(len(data), "honest", seed)
    if len(names) < LEAST_PLACES:
        raise InvalidInputError(
            f"An assessment needs images from at least {LEAST_PLACES} places, to learn from some "
            f"and test on others; these {len(data)} are from {len(names)}. Take them at more poses."
        )
    of_names = split_images(len(names), "honest", seed)
    parts = (of_names.train, of_names.validation, of_names.test)
    return Split(*(np.flatnonzero(np.isin(independence.groups, names[part])) for part in parts))


def check_enough_images(data: PoseImageSet) -> None:
    """Raise InvalidInputError if a data set has fewer than `LEAST_IMAGES` images."""
    if len(data) < LEAST_IMAGES:
        raise InvalidInputError(
            f"An assessment needs at least {LEAST_IMAGES} images to learn from and to test on, "
            f"got {len(data)}; take more."
        )


def _whitened(data: PoseImageSet) -> NDArray[np.float64]:
    """Displacements along their principal axes, each in units of its own spread."""
    poses = _in_metres(data)[:, moves_enough(data)]
    if not poses.size:
        return poses
    poses = (poses - poses.mean(axis=0)) / poses.std(axis=0)
    axes, spreads, _ = np.linalg.svd(poses, full_matrices=False)
    kept = spreads > 0.05 * spreads[0]
    return np.asarray(axes[:, kept] * np.sqrt(len(poses)))


def moves_enough(data: PoseImageSet) -> NDArray[np.bool_]:
    """Whether each dof moves more than the noise of encoders against the others, shape (6,)."""
    spreads = _in_metres(data).std(axis=0)
    return data.moves() & (spreads > _HARDLY_MOVES * spreads.max())


def _in_metres(data: PoseImageSet) -> NDArray[np.float64]:
    """Displacements, rotations by how far they carry the camera about the pivot."""
    return data.delta_p() * np.repeat([1.0, data.pivot or 1.0], 3)


def same_poses(data: PoseImageSet) -> Indices:
    """One group for each pose, up to a nanometre; of a set that never moves one for each image."""
    if not data.moves().any():
        return np.arange(len(data))
    _, groups = np.unique(_in_metres(data).round(9), axis=0, return_inverse=True)
    return groups.astype(np.intp)


def _nearest_neighbours(poses: NDArray[np.float64]) -> tuple[float, float]:
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


def _nearest(poses: NDArray[np.float64]) -> float:
    distances, _ = KDTree(poses).query(poses, k=2)
    return float(np.median(distances[:, 1]))


def _cluster(poses: NDArray[np.float64], most: int, apart: float) -> Indices:
    """Groups of poses near each other: one for each place if there are few places, else `most`."""
    places = _places(poses, most, apart)
    start = poses[places] if len(places) <= most else "k-means++"
    clusters = KMeans(min(len(places), most), init=start, n_init=1, random_state=0)
    return np.asarray(clusters.fit_predict(poses), dtype=np.intp)


def _places(poses: NDArray[np.float64], most: int, apart: float) -> list[int]:
    """Poses that are further than that from each other, and near to all others; some of many."""
    left, places = np.arange(len(poses)), list[int]()
    while left.size and len(places) <= most:
        places.append(int(left[0]))
        left = left[np.linalg.norm(poses[left] - poses[left[0]], axis=1) > apart]
    return places


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
