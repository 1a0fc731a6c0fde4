"""Motion at a constant velocity."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import expm

Array = NDArray[np.float64]


def motion(screw: ArrayLike) -> Array:
    """The displacement that a constant velocity brings about in unit time, (4, 4).

    Parameters
    ----------
    screw : array of shape (6,)
        Linear and angular velocity in the moving frame, [m] and [rad].

    Examples
    --------
    >>> motion([0.1, 0, 0, 0, 0, np.pi / 2]).round(4)[:2, 3]
    array([0.0637, 0.0637])
    """
    v, (x, y, z) = np.reshape(screw, (2, 3))
    twist = np.zeros((4, 4))
    twist[:3, :3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
    twist[:3, 3] = v
    return np.asarray(expm(twist))
