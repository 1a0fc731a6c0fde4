"""How much features hold up when an image is disturbed and the camera stands still."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LARGEST_SHARE = 1.0
"""Features that a disturbance changes more than the pose does do not hold up."""


def disturbance_shares(clean: Array, disturbed: Array) -> Array:
    """Mean square change by each disturbance at fixed pose, over the variance over poses.

    Parameters
    ----------
    clean : ndarray of shape (n_images, n_features)
    disturbed : ndarray of shape (n_images, n_disturbances, n_features)
        Of the same images, each disturbed.

    Returns
    -------
    ndarray of shape (n_features, n_disturbances)
        0 for a feature that no disturbance changes; infinite for one that the pose does not.

    Examples
    --------
    >>> clean = np.array([[-1.0, 3.0], [1.0, 3.0]])
    >>> disturbance_shares(clean, clean[:, None] + [[[0.0, 1.0]], [[0.2, 1.0]]])
    array([[0.02],
           [ inf]])
    """
    change = np.mean((disturbed - clean[:, None]) ** 2, axis=0).T
    variance = np.broadcast_to(clean.var(axis=0)[:, None], change.shape)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(change > 0, change / variance, 0.0)
