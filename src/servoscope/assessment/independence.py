"""Whether images are independent of each other, and which ones have to be kept together."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree
from sklearn.cluster import KMeans

from servoscope.dataset import PoseImageSet
from servoscope.dofs import mask_of
from servoscope.errors import InvalidInputError
from servoscope.splits import Split, split_images

N_GROUPS = 20
"""Into how many groups dependent images are put, if there are enough of them."""

STEP_RATIO, NEIGHBOUR_RATIO = 0.5, 0.3
"""Below these, images count as a sequence, or as taken from places that were visited again."""

LEAST_IMAGES = 60
"""Of so many, drawn at random, 45 are learned from and 15 tested on."""

LEAST_LEARNED = 40

LEAST_PLACES = 8
"""Of fewer places there is none to test on that is not learned from."""

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
    """Whether each dof moves by more than the noise of encoders, shape (6,)."""
    return mask_of(data.dofs)


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
