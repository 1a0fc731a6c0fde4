"""The relief: an inverse depth for every pixel of the reference image.

A plane sweep (Collins, CVPR 1996) tries inverse depths at every pixel; semi-global matching
(Hirschmueller, PAMI 30(2), 2008) picks those that agree with the images and with their neighbours,
with jumps where the image has edges.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.compiled import compiled
from servoscope.keyframe.warping import _look

Floats = NDArray[np.float32]

STEP_PENALTY = 0.08
"""What a change by one label to the next pixel costs, in units of a standard deviation."""

JUMP_PENALTY = 0.6
"""What a larger change costs where the image is even."""

CAP = 3.0
"""Most that a residual counts for, in standard deviations."""


@compiled(fastmath=True, error_model="numpy")
def sweep_costs(
    images: NDArray[Any],
    transforms: NDArray[Any],
    camera: NDArray[Any],
    aspect: float,
    points: NDArray[Any],
    rays: NDArray[Any],
    labels: NDArray[Any],
    reference: NDArray[Any],
    light: NDArray[Any],
    scale: NDArray[Any],
) -> NDArray[Any]:
    """Mean cost of every inverse depth at every point, shape (n, n_labels), float32.

    The cost of an image is its residual in standard deviations, `CAP` at most; a point that no
    image sees costs nothing anywhere.

    Parameters
    ----------
    images : array of shape (n_images, height, width), float32
    transforms : array of shape (n_images, 4, 4)
        Reference camera to each camera.
    camera : array of shape (5,)
    aspect : float
    points, rays : arrays of shape (n, 2), float32
    labels : array of shape (n_labels,) or (n_labels, n), float32
        Inverse depths that are tried at each point.
    reference : array of shape (n,), float32
    light : array of shape (n_images, 4)
    scale : array of shape (n_images,)
        Standard deviation of each image's residuals, [grey].
    """
    n_labels, n = labels.shape
    costs = np.zeros((n, n_labels), np.float32)
    for i in range(n):
        x, y = rays[i, 0], rays[i, 1]
        for j in range(n_labels):
            total, n_seen = 0.0, 0
            for k in range(images.shape[0]):
                seen = _look(images[k], transforms[k], camera, aspect, x, y, labels[j, i])
                if seen[0]:
                    gain = light[k, 0] + light[k, 2] * points[i, 0] + light[k, 3] * points[i, 1]
                    r = abs(seen[1] - gain * reference[i] - light[k, 1]) / scale[k]
                    total += min(r, CAP)
                    n_seen += 1
            if n_seen > 0:
                costs[i, j] = total / n_seen
    return costs


@compiled(fastmath=True, error_model="numpy")
def _pass(
    costs: NDArray[Any],
    guide: NDArray[Any],
    backwards: bool,
    step_penalty: float,
    jump_penalty: float,
    edge: float,
    out: NDArray[Any],
) -> None:
    """Add the costs of the cheapest paths along the second axis of (rows, columns, labels)."""
    rows, columns, n_labels = costs.shape
    before, now = np.empty(n_labels, np.float32), np.empty(n_labels, np.float32)
    for row in range(rows):
        before[:] = 0.0
        least = np.float32(0.0)
        last = np.float32(0.0)
        for step in range(columns):
            column = columns - 1 - step if backwards else step
            grey = guide[row, column]
            jump = jump_penalty / (1.0 + abs(grey - last) / edge) if step else 0.0
            jump = max(jump, step_penalty)
            new_least = np.float32(1e9)
            for j in range(n_labels):
                cheapest = min(before[j], least + jump)
                if j > 0:
                    cheapest = min(cheapest, before[j - 1] + step_penalty)
                if j < n_labels - 1:
                    cheapest = min(cheapest, before[j + 1] + step_penalty)
                now[j] = costs[row, column, j] + cheapest - least
                new_least = min(new_least, now[j])
                out[row, column, j] += now[j]
            for j in range(n_labels):
                before[j] = now[j]
            least, last = new_least, grey


def semi_global_labels(costs: Floats, guide: Floats, edge: float) -> Floats:
    """The label of each pixel, to a fraction, shape (height, width).

    Parameters
    ----------
    costs : ndarray of shape (height, width, n_labels), float32
    guide : ndarray of shape (height, width), float32
        The reference image.
    edge : float
        A step of grey levels that halves the penalty of a jump.
    """
    total = np.zeros_like(costs)
    sideways = np.ascontiguousarray(costs.transpose(1, 0, 2))
    down = np.zeros_like(sideways)
    turned = np.ascontiguousarray(guide.T)
    for backwards in (False, True):
        _pass(costs, guide, backwards, STEP_PENALTY, JUMP_PENALTY, edge, total)
        _pass(sideways, turned, backwards, STEP_PENALTY, JUMP_PENALTY, edge, down)
    total += down.transpose(1, 0, 2)
    best = total.argmin(axis=2)
    inner = np.clip(best, 1, costs.shape[2] - 2)[..., None]
    a, b, c = (np.take_along_axis(total, inner + k, axis=2)[..., 0] for k in (-1, 0, 1))
    bend = np.maximum(a + c - 2 * b, 1e-6)
    shift = np.where(best == inner[..., 0], np.clip(0.5 * (a - c) / bend, -0.5, 0.5), 0)
    return (best + shift).astype(np.float32)
