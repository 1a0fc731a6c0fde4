"""Whether images are independent of each other, and which ones have to be kept together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree
from sklearn.cluster import KMeans

from servoscope.dataset import PoseImageSet
from servoscope.errors import InvalidInputError
from servoscope.splits import Split, split_images

N_GROUPS = 20
"""Into how many groups dependent images are put, if there are enough of them."""

STEP_RATIO, NEIGHBOUR_RATIO = 0.5, 0.3
"""Below these, images count as a sequence, or as taken from places that were visited again."""

LEAST_IMAGES = 60
"""Of so many, drawn at random, 45 are learned from and 15 tested on."""

LEAST_LEARNED = 40

Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Independence:
    """How images depend on each other.

    Parameters
    ----------
    kind : {"independent", "sequence", "revisited"}
    groups : ndarray of shape (n_images,)
        Images of one group must not be both learned from and tested on.
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
    to its nearest neighbour, over the same after every coordinate was permuted by itself.
    Coordinates are those of the displacements along their principal axes, in units of their
    spread.
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
    neighbour_ratio = _neighbour_ratio(poses)
    if neighbour_ratio < NEIGHBOUR_RATIO:
        clusters = KMeans(n_groups, n_init=1, random_state=0).fit_predict(poses)
        return Independence("revisited", clusters.astype(np.intp), neighbour_ratio)
    return Independence("independent", np.arange(len(data)), step_ratio)


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
    if independence.kind == "independent":
        return split_images(len(data), "honest", seed)
    if independence.kind == "sequence":
        times = np.arange(len(data)) if data.times is None else data.times
        return split_images(len(data), "honest", seed, times)
    names = np.unique(independence.groups)
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
    moved = data.moves()
    poses = (data.delta_p() / data.ranges())[:, moved]
    if not moved.any():
        return poses
    poses = (poses - poses.mean(axis=0)) / poses.std(axis=0)
    axes, spreads, _ = np.linalg.svd(poses, full_matrices=False)
    kept = spreads > 0.05 * spreads[0]
    return np.asarray(axes[:, kept] * np.sqrt(len(poses)))


def _neighbour_ratio(poses: NDArray[np.float64]) -> float:
    """Distance to the nearest neighbour over that of poses with their coordinates permuted."""
    if poses.shape[1] < 2:
        return 1.0
    rng = np.random.default_rng(0)
    shuffled = np.column_stack([rng.permutation(column) for column in poses.T])
    return _nearest(poses) / max(_nearest(shuffled), 1e-12)


def _nearest(poses: NDArray[np.float64]) -> float:
    distances, _ = KDTree(poses).query(poses, k=2)
    return float(np.median(distances[:, 1]))
