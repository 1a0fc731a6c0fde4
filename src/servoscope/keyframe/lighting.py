"""Light that differs from that of the reference: a gain and an offset that vary smoothly."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from servoscope.compiled import compiled
from servoscope.keyframe.robust import BLOCK, add_products, fill_upper

Array = NDArray[np.float64]
N_POSE = 7
"""Unknowns before those of the light: a twist, and defocus."""

_GAIN, _OFFSET = 0.1, 8.0
"""Standard deviations of the difference between neighbouring nodes, of gain and offset [grey]."""

_ANY_GAIN, _ANY_OFFSET = 3.0, 100.0
"""The same of what all nodes share."""


@dataclass(frozen=True, eq=False)
class Light:
    """Gain and offset over the view, between nodes of a square grid as straight lines.

    Parameters
    ----------
    nodes : ndarray of shape (2, k, k)
        Gain, and offset [grey], at k by k nodes from corner to corner of the reference image.
    defocus : float
        How much of the Laplacian of the reference image is added.
    """

    nodes: Array
    defocus: float = 0.0

    @classmethod
    def even(cls, k: int) -> Light:
        """That of the reference."""
        return cls(np.stack([np.ones((k, k)), np.zeros((k, k))]))

    def resized(self, k: int) -> Light:
        """The same light at k by k nodes."""
        before = np.linspace(0, 1, self.nodes.shape[1])
        hats = np.array([np.interp(np.linspace(0, 1, k), before, e) for e in np.eye(len(before))])
        return Light(hats.T @ self.nodes @ hats, self.defocus)

    def unevenness(self, grey: Array) -> float:
        """By how much it changes grey levels over the view, in shares of how they differ."""
        change = self.nodes[0] * float(grey.mean()) + self.nodes[1]
        return float(change.std() / max(float(grey.std()), 1.0))

    def moved(self, step: NDArray[np.floating]) -> Light:
        """After a step of defocus and all nodes."""
        nodes = self.nodes + step[1:].reshape(self.nodes.shape)
        return Light(nodes, self.defocus + float(step[0]))


class LightGrid:
    """The nodes that each point of the reference image lies between.

    Parameters
    ----------
    points : ndarray of shape (n, 2)
        [image widths] from the middle.
    aspect : float
        Height over width of the image.
    k : int
        Nodes along each side, two or more.
    stiffness : float
        By how much light is less uneven than is expected elsewhere.

    Attributes
    ----------
    order : ndarray of shape (n,)
        The order that all other arrays of points are in, and are expected in: cell by cell.
    prior : ndarray of shape (7 + 2 * k**2, 7 + 2 * k**2)
        Inverse covariance of defocus, gains and offsets before the image is seen; 0 of the twist.
    """

    def __init__(self, points: Array, aspect: float, k: int, stiffness: float = 1.0) -> None:
        self.k, self._even = k, Light.even(k).nodes
        at = (points / [1.0, aspect] + 0.5).clip(0, 1) * (k - 1)
        corner = np.minimum(at.astype(int), k - 2)
        cell = corner[:, 1] * (k - 1) + corner[:, 0]
        self.order = np.argsort(cell, kind="stable")
        self.starts = np.searchsorted(cell[self.order], np.arange((k - 1) ** 2 + 1))
        u, v = (at - corner)[self.order].T
        shares = np.stack([(1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v], axis=1)
        self.shares = shares
        row, column = np.divmod(np.arange((k - 1) ** 2), k - 1)
        first = row * k + column
        self.nodes = np.stack([first, first + 1, first + k, first + k + 1], axis=1)
        apart = (_rough(k, _GAIN), _rough(k, _OFFSET))
        alike = (_ANY_GAIN**-2.0 / k**4, _ANY_OFFSET**-2.0 / k**4)
        nodes = [stiffness**2 * own + shared for own, shared in zip(apart, alike, strict=True)]
        self.prior = block_diag(np.zeros((N_POSE - 1, N_POSE - 1)), 1.0, *nodes)

    def at_points(self, light: Light) -> tuple[Array, Array]:
        """Gain and offset at each point, (n,) each."""
        fields = np.zeros((2, len(self.order)))
        _add_field(light.nodes.reshape(2, -1), self.shares, self.starts, self.nodes, fields)
        return fields[0], fields[1]

    def normal_equations(
        self,
        jacobian: Array,
        residuals: Array,
        weights: Array,
        laplacian: Array,
        grey: Array,
        light: Light,
    ) -> tuple[Array, Array]:
        """Of twist, defocus, gains and offsets; the light's prior is in them."""
        uneven = (light.nodes - self._even).ravel()
        known = np.concatenate([np.zeros(N_POSE - 1), [light.defocus], uneven])
        H, g = self.prior.copy(), -self.prior @ known
        _accumulate(
            jacobian,
            residuals,
            weights,
            laplacian,
            grey,
            self.shares,
            self.starts,
            self.nodes,
            H,
            g,
        )
        return H, g

    def without_light(self, jacobian: Array, laplacian: Array, grey: Array, H: Array) -> Array:
        """Derivatives by the twist less what light and defocus make alike, (n, 6).

        With H the normal equations of all, what light and defocus do for a step of the twist is
        ``-inv(H_ll) H_lm``.
        """
        follows = np.linalg.solve(H[6:, 6:], H[6:, :6])
        nodes = follows[1:].reshape(2, self.k**2, 6).transpose(0, 2, 1).reshape(12, -1)
        fields = np.zeros((12, len(self.order)))
        _add_field(np.ascontiguousarray(nodes), self.shares, self.starts, self.nodes, fields)
        made = grey * fields[:6] + fields[6:] + np.outer(follows[0], laplacian)
        return np.asarray(jacobian + made.T)


def _rough(k: int, deviation: float) -> Array:
    """Precision of k by k nodes whose neighbours differ by a standard deviation."""
    D = np.diff(np.eye(k), axis=0)
    line = D.T @ D
    return (np.kron(line, np.eye(k)) + np.kron(np.eye(k), line)) / deviation**2


@compiled(fastmath=True, error_model="numpy")
def _add_field(
    values: NDArray[Any],
    shares: NDArray[Any],
    starts: NDArray[Any],
    nodes: NDArray[Any],
    fields: NDArray[Any],
) -> None:
    """Add to `fields` (m, n) what values at nodes (m, n_nodes) are at the points."""
    for j in range(values.shape[0]):
        for cell in range(starts.shape[0] - 1):
            a, b = values[j, nodes[cell, 0]], values[j, nodes[cell, 1]]
            c, d = values[j, nodes[cell, 2]], values[j, nodes[cell, 3]]
            for i in range(starts[cell], starts[cell + 1]):
                fields[j, i] += (
                    a * shares[i, 0] + b * shares[i, 1] + c * shares[i, 2] + d * shares[i, 3]
                )


@compiled(fastmath=True, error_model="numpy")
def _accumulate(
    jacobian: NDArray[Any],
    residuals: NDArray[Any],
    weights: NDArray[Any],
    laplacian: NDArray[Any],
    grey: NDArray[Any],
    shares: NDArray[Any],
    starts: NDArray[Any],
    nodes: NDArray[Any],
    H: NDArray[Any],
    g: NDArray[Any],
) -> None:
    """Add to H, which is symmetric, and to g what the points contribute, cell by cell.

    Parameters
    ----------
    jacobian : array of shape (n, 6)
    residuals, weights, laplacian, grey : arrays of shape (n,)
    shares : array of shape (n, 4)
        Of each node of its cell in a point.
    starts : array of shape (n_cells + 1,)
        Where the points of each cell begin.
    nodes : array of shape (n_cells, 4)
    H : array of shape (7 + 2 * n_nodes, 7 + 2 * n_nodes)
    g : array of shape (7 + 2 * n_nodes,)
    """
    n_nodes = (H.shape[0] - 7) // 2
    at = np.empty(15, np.int64)
    for j in range(7):
        at[j] = j
    rows, weighted = np.empty((15, BLOCK)), np.empty((15, BLOCK))
    block, slope = np.empty((15, 15)), np.empty(15)
    for cell in range(starts.shape[0] - 1):
        block[:] = 0.0
        slope[:] = 0.0
        for start in range(starts[cell], starts[cell + 1], BLOCK):
            n_points = min(BLOCK, starts[cell + 1] - start)
            for p in range(n_points):
                i = start + p
                for j in range(6):
                    rows[j, p] = jacobian[i, j]
                rows[6, p] = -laplacian[i]
                for j in range(4):
                    rows[7 + j, p] = -grey[i] * shares[i, j]
                    rows[11 + j, p] = -shares[i, j]
                for j in range(15):
                    weighted[j, p] = weights[i] * rows[j, p]
            add_products(rows, weighted, n_points, block)
            for j in range(15):
                total = 0.0
                for p in range(n_points):
                    total += weighted[j, p] * residuals[start + p]
                slope[j] -= total
        for j in range(4):
            at[7 + j] = 7 + nodes[cell, j]
            at[11 + j] = 7 + n_nodes + nodes[cell, j]
        for j in range(15):
            g[at[j]] += slope[j]
            for k in range(j + 1):
                H[at[j], at[k]] += block[j, k]
    fill_upper(H)
