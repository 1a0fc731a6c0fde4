"""How the camera sits on the robot, found from nothing: many starts at low resolution."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from servoscope.compiled import compiled
from servoscope.keyframe.warping import _look

Array = NDArray[np.float64]


def spread_rotations(n: int) -> Array:
    """The 24 turns of a cube and n rotations spread evenly, shape (24 + n, 3, 3).

    The latter are a super-Fibonacci spiral (Alexa, CVPR 2022).
    """
    s = np.arange(n) + 0.5
    phi, psi = np.sqrt(2.0), 1.533751168755204288118041
    alpha, beta = 2 * np.pi * s / phi, 2 * np.pi * s / psi
    r, R = np.sqrt(s / n), np.sqrt(1 - s / n)
    xyzw = np.stack([r * np.sin(alpha), r * np.cos(alpha), R * np.sin(beta), R * np.cos(beta)], 1)
    cube = Rotation.create_group("O").as_matrix()
    order = np.argsort(Rotation.from_matrix(cube).magnitude(), kind="stable")
    return np.concatenate([cube[order], Rotation.from_quat(xyzw).as_matrix()])


@compiled(fastmath=True, error_model="numpy")
def correlation(
    image: NDArray[Any],
    T: NDArray[Any],
    camera: NDArray[Any],
    aspect: float,
    rays: NDArray[Any],
    inverse_depth: NDArray[Any],
    reference: NDArray[Any],
) -> float:
    """Correlation of an image with the reference, over the points that it sees.

    Zero if it sees less than a quarter of them.

    Parameters
    ----------
    image : array of shape (height, width), float32
    T : array of shape (4, 4)
        Reference camera to this camera.
    camera : array of shape (5,)
    aspect : float
    rays : array of shape (n, 2), float32
    inverse_depth, reference : arrays of shape (n,), float32

    Returns
    -------
    float
    """
    n_points = rays.shape[0]
    n, a, b, aa, bb, ab = 0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(n_points):
        seen = _look(image, T, camera, aspect, rays[i, 0], rays[i, 1], inverse_depth[i])
        if seen[0]:
            grey, expected = seen[1], reference[i]
            n += 1
            a += grey
            b += expected
            aa += grey * grey
            bb += expected * expected
            ab += grey * expected
    if 4 * n < n_points:
        return 0.0
    return (ab - a * b / n) / np.sqrt((aa - a * a / n) * (bb - b * b / n) + 1e-6)
