"""Shots of one pose: samples nearer to each other than different poses ever are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree

from servoscope.kernels.gaussian import Array

Groups = NDArray[np.intp]

LEAST_GAP = 3.0
"""Shots of one pose are by this factor nearer to each other than to those of another."""

LEAST_SHARE = 0.2
"""Share of the samples that have to repeat others before near ones count as repeated: some of
the samples of any set are next to each other by chance."""

LEAST_POSES = 8
"""Of fewer clusters it is not known whether each is one pose: poses near the reference make one,
beside those of a wider range."""

MOST_SHOTS = 50
"""Targets that are equal more often than that are levels, of a grid or of a discrete target, and
larger clusters are of different poses."""

MOST_WITHIN = 0.05
"""Share of the variance that may be within the poses: of the features where targets are equal, of
the targets where features are near."""

_BLOCK = 2**20
"""Numbers that are worked on at a time."""

_LOOSE = 0.25
"""A group of equal targets with a sample farther from its mean than this, in shares of the
variance of the features, is of several poses."""


def find_repeats(X: Array, y: Array) -> Groups:
    """Which samples are repeated shots of one pose:

    a number from 0 for each, in the order of their first. Where no feature varies each sample is by
    itself.

    Notes
    -----
    Samples of equal features are shots of one pose. So are those of equal targets, unless many
    are equal, if all such samples together hardly differ in their features. So are those whose
    features are near: the edges of the minimum spanning tree fall into short and long ones with a
    gap of `LEAST_GAP` between them, and the short ones are no few and join several clusters that
    are small against the gap and over which the targets hardly change.

    Examples
    --------
    >>> poses = np.random.default_rng(0).uniform(size=(40, 2))
    >>> shots = np.repeat(poses, 3, axis=0)
    >>> shots += 1e-5 * np.random.default_rng(1).normal(size=shots.shape)
    >>> find_repeats(shots, shots[:, 0])[:7]
    array([0, 0, 0, 1, 1, 1, 2])
    >>> len(np.unique(find_repeats(poses, poses[:, 0])))
    40
    """
    n = len(X)
    Z, T = _standardised(X), _standardised(y.reshape(n, -1))
    if not Z.any():
        return np.arange(n)
    found = [_equal_rows(Z)]
    by_features, by_targets = _clusters(Z), _tight(_clusters(T), Z)
    if _variance_within(by_features, T) <= MOST_WITHIN:
        found.append(by_features)
    if (
        _variance_within(by_targets, Z) <= MOST_WITHIN
        and np.bincount(by_targets).max() <= MOST_SHOTS
    ):
        found.append(by_targets)
    return _in_order(_joined(found))


def merge_repeats(X: Array, y: Array, poses: Groups) -> tuple[Array, Array]:
    """The mean of each pose's features and targets."""
    if len(poses) == poses.max() + 1:
        return X, y
    return _means(X, poses), _means(y, poses)


def whole_poses(poses: Groups, groups: Groups) -> Groups:
    """Groups of shots in which no pose is divided."""
    return _in_order(_joined([poses, groups]))


def _standardised(table: Array) -> Array:
    """Columns of zero mean and unit variance, without those that are constant."""
    spread = table.std(axis=0)
    varies = spread > 1e-12 * np.abs(table).max(axis=0)
    return np.asarray((table[:, varies] - table[:, varies].mean(axis=0)) / spread[varies])


def _equal_rows(table: Array) -> Groups:
    if not table.size:
        return np.zeros(len(table), np.intp)
    return np.unique(table, axis=0, return_inverse=True)[1].astype(np.intp).ravel()


def _clusters(table: Array) -> Groups:
    """Rows that are equal, or near where the table shows that it repeats its rows."""
    equal = _equal_rows(table)
    distinct = _means(table, equal)
    n = len(distinct)
    if n <= LEAST_POSES:
        return equal
    graph = _neighbours(distinct, min(MOST_SHOTS, n - 1))
    edges = minimum_spanning_tree(graph.maximum(graph.T)).tocoo()
    lengths, least = np.sort(edges.data), int(LEAST_SHARE * n)
    ratios = lengths[least:] / lengths[least - 1 : -1]
    if not ratios.size or ratios.max() < LEAST_GAP:
        return equal
    longer = lengths[least + int(np.argmax(ratios))]
    short = edges.data < longer
    groups = _connected(edges.row[short], edges.col[short], n)
    radius = np.sqrt(np.square(distinct - _means(distinct, groups)[groups]).sum(axis=1).max())
    sizes = np.bincount(groups)
    if np.sum(sizes > 1) < LEAST_POSES or sizes.max() > MOST_SHOTS or radius * LEAST_GAP > longer:
        return equal
    return groups[equal]


def _neighbours(rows: Array, n_neighbours: int) -> csr_array:
    """Distances of each row to its nearest ones.

    Which ones these are is found from inner products, in which 1e-9 may be 0 by cancellation, but
    their distances from differences.
    """
    n, n_block = len(rows), max(_BLOCK // (n_neighbours * rows.shape[1] + len(rows)), 1)
    half_squares = 0.5 * np.einsum("ij,ij->i", rows, rows)
    nearest, distances = np.empty((2, n, n_neighbours))
    for start in range(0, n, n_block):
        block = np.arange(start, min(start + n_block, n))
        order = half_squares - rows[block] @ rows.T
        order[np.arange(len(block)), block] = np.inf
        found = np.argpartition(order, n_neighbours - 1, axis=1)[:, :n_neighbours]
        nearest[block] = found
        distances[block] = np.linalg.norm(rows[found] - rows[block, None], axis=2)
    ends = np.arange(0, nearest.size + 1, n_neighbours, dtype=np.int32)  # csgraph takes no others
    return csr_array((distances.ravel(), nearest.ravel().astype(np.int32), ends), shape=(n, n))


def _tight(groups: Groups, values: Array) -> Groups:
    """The groups but those whose own values vary as those of different poses may, by chance."""
    squares = np.square(values - _means(values, groups)[groups]).sum(axis=1)
    within = np.zeros(groups.max() + 1)
    np.maximum.at(within, groups, squares)
    is_loose = (within > _LOOSE * np.square(values).sum(axis=1).mean())[groups]
    return _in_order(np.where(is_loose, groups.max() + 1 + np.arange(len(groups)), groups))


def _variance_within(groups: Groups, values: Array) -> float:
    """Variance of repeated rows about the mean of their group, as a share of that of all rows."""
    repeated = np.bincount(groups)[groups] > 1
    if not repeated.any() or not values.size:
        return 0.0
    return float(np.square(values - _means(values, groups)[groups])[repeated].mean())


def _joined(several: list[Groups]) -> Groups:
    """The finest groups in which the groups of each are whole."""
    n = len(several[0])
    nodes = np.concatenate([groups + (1 + i) * n for i, groups in enumerate(several)])
    return _connected(np.tile(np.arange(n), len(several)), nodes, (1 + len(several)) * n)[:n]


def _connected(a: NDArray, b: NDArray, n: int) -> Groups:
    """The connected components of n nodes, given the two ends of each link."""
    links = csr_array((np.ones(len(a)), (a, b)), shape=(n, n))
    return connected_components(links, directed=False)[1].astype(np.intp)


def _means(values: Array, groups: Groups) -> Array:
    n = len(groups)
    sums = csr_array((np.ones(n), (groups, np.arange(n))), shape=(groups.max() + 1, n)) @ values
    sizes = np.bincount(groups).reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray(sums / sizes)


def _in_order(groups: Groups) -> Groups:
    """The same groups, numbered by their first members."""
    _, first, members = np.unique(groups, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[members].astype(np.intp)
