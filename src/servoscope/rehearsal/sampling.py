"""Grey levels of an image where points of space are seen in it."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from servoscope.keyframe.camera import CameraModel
from servoscope.keyframe.rendering import project

Array = NDArray[np.float64]


def sample_at(image: NDArray[Any], camera: CameraModel, points: Array, border: int) -> NDArray[Any]:
    """The image where a camera sees points, interpolated.

    Parameters
    ----------
    image : ndarray of shape (height, width)
    camera : CameraModel
        That took it.
    points : ndarray of shape (rows, columns, 3)
        Before the camera, of any scale.
    border : int
        Of OpenCV: how the image goes on beyond its edges, up to its size; points farther off are
        seen there.

    Returns
    -------
    ndarray of shape (rows, columns)

    Examples
    --------
    A point on the axis is seen in the middle, between the four pixels of a small image:

    >>> image = np.array([[0.0, 2.0], [4.0, 6.0]])
    >>> sample_at(image, CameraModel(1.0), np.array([[[0.0, 0.0, 3.0]]]), cv2.BORDER_REFLECT)
    array([[3.]])
    """
    shape, (height, width) = points.shape[:2], image.shape
    flat = points.reshape(-1, 3)
    z = np.maximum(flat[:, 2], 1e-3)
    seen = np.empty(flat.shape)
    project(np.eye(4), camera.values, height / width, flat[:, :2] / z[:, None], 1 / z, seen)
    column = _pixels((seen[:, 0] + 0.5) * width - 0.5, width).reshape(shape)
    row = _pixels((seen[:, 1] * width / height + 0.5) * height - 0.5, height).reshape(shape)
    return np.asarray(cv2.remap(image, column, row, cv2.INTER_LINEAR, borderMode=border))


def _pixels(at: Array, size: int) -> NDArray[np.float32]:
    """Finite and not far away: OpenCV walks back from there, one image after the other."""
    near = np.clip(np.nan_to_num(at), -size, 2 * size)
    return np.asarray(near, dtype=np.float32)
