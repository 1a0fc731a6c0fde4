"""Robust weights and weighted normal equations of many residuals, compiled.

A residual of scale s counts by the Geman-McClure function ``u / (1 + u)``, ``u = (r / (BEND s))^2``
(Black and Rangarajan, IJCV 19(1), 1996), whose weight is ``1 / (1 + u)^2``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.compiled import compiled
from servoscope.keyframe.warping import UNSEEN

BEND = 2.5
"""Residuals of this many standard deviations count a quarter."""

BLOCK = 128
"""Points that are summed at a time, so that what they need stays in the cache."""

MOST_RANKED = 4096


def robust_scale(residuals: NDArray[Any], least: float) -> float:
    """Standard deviation of most residuals, [grey]; 255 where little is seen.

    Parameters
    ----------
    residuals : ndarray of shape (n,)
    least : float
        What it is never below, [grey].
    """
    some = residuals[:: max(1, len(residuals) // MOST_RANKED)]
    seen = some[some > UNSEEN]
    if 4 * len(seen) < len(some):
        return 255.0
    return max(least, 1.4826 * _median(np.abs(seen)))


def _median(values: NDArray[Any]) -> float:
    """As `numpy.median`, at a third of its time."""
    half = len(values) // 2
    if len(values) % 2:
        return float(np.partition(values, half)[half])
    below, above = np.partition(values, (half - 1, half))[half - 1 : half + 1]
    return float(below + above) / 2


@compiled(fastmath=True, error_model="numpy")
def robust_weights(residuals: NDArray[Any], scale: float, weights: NDArray[Any]) -> float:
    """Write the weight of each residual, 0 where nothing is seen.

    Parameters
    ----------
    residuals : array of shape (n,)
    scale : float
        [grey].
    weights : array of shape (n,), of the residuals' type
        Written.

    Returns
    -------
    float
        Sum of ``u / (1 + u)`` over those that are seen.
    """
    number = weights.dtype.type
    inverse, zero, one = number(1.0 / (BEND * scale)), number(0.0), number(1.0)
    left = zero
    for i in range(residuals.shape[0]):
        r = residuals[i] * inverse
        share = one / (one + r * r)
        seen = residuals[i] > UNSEEN
        weights[i] = share * share if seen else zero
        left += one - share if seen else zero
    return float(left)


@compiled(fastmath=True, error_model="numpy")
def curvature_ratio(residuals: NDArray[Any], weights: NDArray[Any], scale: float) -> float:
    """Curvature of the robust cost over that of the weighted squares, 1 at most.

    It is ``E[psi'] / E[w]`` of M-estimation: a residual of the weight ``w`` bends the former by
    ``w (1 - 3 u) / (1 + u)``, the latter by w.

    Parameters
    ----------
    residuals, weights : arrays of shape (n,)
    scale : float
        [grey].
    """
    inverse = 1.0 / (BEND * scale)
    total, changed = 0.0, 0.0
    for i in range(residuals.shape[0]):
        u = (residuals[i] * inverse) ** 2
        total += weights[i]
        changed += weights[i] * (1.0 - 3.0 * u) / (1.0 + u)
    return changed / max(total, 1e-12)


@compiled(fastmath=True, error_model="numpy", inline="always")
def add_products(
    rows: NDArray[Any],
    weighted: NDArray[Any],
    n_points: int,
    H: NDArray[Any],
) -> None:
    """Add to the lower half of H, (m, m), the products of two arrays of columns, (m, BLOCK)."""
    for j in range(H.shape[0]):
        for k in range(j + 1):
            total = rows.dtype.type(0.0)
            for p in range(n_points):
                total += weighted[j, p] * rows[k, p]
            H[j, k] += total


@compiled(inline="always")
def fill_upper(H: NDArray[Any]) -> None:
    """Make a matrix symmetric whose lower half is known."""
    for j in range(H.shape[0]):
        for k in range(j):
            H[k, j] = H[j, k]


@compiled(fastmath=True, error_model="numpy")
def normal_equations(
    jacobian: NDArray[Any],
    residuals: NDArray[Any],
    weights: NDArray[Any],
    H: NDArray[Any],
    g: NDArray[Any],
) -> None:
    """Write ``J' W J`` and ``-J' W r``.

    Parameters
    ----------
    jacobian : array of shape (n, m), float32
    residuals, weights : arrays of shape (n,), float32
    H : array of shape (m, m)
        Written.
    g : array of shape (m,)
        Written.
    """
    n, m = jacobian.shape
    rows, weighted = np.empty((m, BLOCK), np.float32), np.empty((m, BLOCK), np.float32)
    H[:] = 0.0
    g[:] = 0.0
    for start in range(0, n, BLOCK):
        n_points = min(BLOCK, n - start)
        for p in range(n_points):
            w = weights[start + p]
            for j in range(m):
                rows[j, p] = jacobian[start + p, j]
                weighted[j, p] = w * jacobian[start + p, j]
        add_products(rows, weighted, n_points, H)
        for j in range(m):
            total = np.float32(0.0)
            for p in range(n_points):
                total += weighted[j, p] * residuals[start + p]
            g[j] -= total
    fill_upper(H)
