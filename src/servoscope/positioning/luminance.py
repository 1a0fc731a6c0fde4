"""How grey levels change with the motion of the camera."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

MARGIN = 3
"""Pixels along each side of an image whose slopes are not to be relied on."""

_DERIVATIVE = np.array([-112, -913, -2047, 0, 2047, 913, 112]) / 8418
"""Weights of seven pixels in a row whose sum is the slope in the middle."""

SMOOTHING_PX = 0.99
"""Those slopes are of an image smoothed by a Gaussian of this deviation."""


def luminance_interaction(
    image: ArrayLike,
    depth: ArrayLike,
    focal_px: float,
    principal_px: tuple[float, float],
    distortion: tuple[float, float] = (0.0, 0.0),
) -> Array:
    """Change of each grey level with the velocity of the camera.

    Parameters
    ----------
    image : array of shape (height, width)
    depth : float or array of shape (height, width)
        Along the camera's z, [m].
    focal_px : float
        [px].
    principal_px : tuple of 2 floats
        Column and row, [px]; pixel centres at whole numbers.
    distortion : tuple of 2 floats
        k1 and k2, as in OpenCV.

    Returns
    -------
    ndarray of shape (6, height, width)
        [grey/m] for tx, ty, tz and [grey/rad] for rx, ry, rz.

    Notes
    -----
    ``L_I = -(grad I)^T L_x`` with L_x the interaction matrix of a point; Collewet and Marchand,
    "Photometric Visual Servoing", 2011, for surfaces that keep their light.

    Examples
    --------
    >>> ramp = np.tile(np.arange(9.0), (9, 1))  # a grey level each pixel to the right
    >>> luminance_interaction(ramp, 0.5, 100.0, (4.0, 4.0))[:, 4, 4].round(6) + 0.0
    array([200.,   0.,   0.,   0., 100.,   0.])
    """
    image = np.asarray(image, dtype=float)
    x, y = _unit_depth(image.shape, focal_px, principal_px, distortion)
    along_x, along_y = _slopes(image, x, y, focal_px, distortion)
    outward = x * along_x + y * along_y
    nearness = 1 / np.asarray(depth, dtype=float)
    return np.stack(
        [
            along_x * nearness,
            along_y * nearness,
            -outward * nearness,
            -along_y - y * outward,
            along_x + x * outward,
            x * along_y - y * along_x,
        ]
    )


def _unit_depth(
    image_shape: tuple[int, ...],
    focal_px: float,
    principal_px: tuple[float, float],
    distortion: tuple[float, float],
) -> Array:
    """Where what each pixel sees lies at unit depth: x and y, shape (2, height, width)."""
    rows, columns = np.indices(image_shape, dtype=float)
    seen = np.stack([columns, rows], axis=-1).reshape(-1, 1, 2)
    K = np.array([[focal_px, 0, principal_px[0]], [0, focal_px, principal_px[1]], [0, 0, 1.0]])
    ideal = cv2.undistortPoints(seen, K, np.array([*distortion, 0.0, 0.0]))
    return np.asarray(ideal.reshape(*image_shape, 2).transpose(2, 0, 1))


def _slopes(
    image: Array, x: Array, y: Array, focal_px: float, distortion: tuple[float, float]
) -> tuple[Array, Array]:
    """Slope of the image along x and y, at unit depth, [grey]."""
    k1, k2 = distortion
    along_u = cv2.filter2D(image, -1, _DERIVATIVE[None, :])
    along_v = cv2.filter2D(image, -1, _DERIVATIVE[:, None])
    r2 = x**2 + y**2
    stretch = focal_px * (1 + k1 * r2 + k2 * r2**2)
    outward = focal_px * (2 * k1 + 4 * k2 * r2) * (x * along_u + y * along_v)
    return stretch * along_u + x * outward, stretch * along_v + y * outward
