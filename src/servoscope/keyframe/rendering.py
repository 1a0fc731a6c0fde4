"""What the keyframe would look like from elsewhere."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from servoscope.compiled import compiled
from servoscope.keyframe.camera import CameraModel
from servoscope.keyframe.levels import View

JUMP = 0.03
"""Neighbours whose inverse depths differ by a larger share belong to different surfaces."""


class Renderer:
    """Shows the reference view, at one width, from elsewhere.

    Parameters
    ----------
    view : View
        The reference image at the width that is wanted.
    camera : CameraModel
    inverse_depth : ndarray, float32
        Over the reference image, of any resolution. Single pixels that stand out are left out.
    """

    def __init__(self, view: View, camera: CameraModel, inverse_depth: NDArray[np.float32]) -> None:
        self._camera, self._aspect = camera.values, view.aspect
        self._depth = view.resize(cv2.medianBlur(inverse_depth, 5)).astype(float)
        self._rays, _ = camera.rays(view.points)
        self._grey = view.grey.astype(float)

    def __call__(self, T: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Grey levels that are seen after a motion of the camera, and where they are known.

        Parameters
        ----------
        T : ndarray of shape (4, 4)
            Reference camera to this camera.
        """
        shape = self._grey.shape
        mesh = np.empty((*shape, 3))
        flat = mesh.reshape(-1, 3)
        project(T, self._camera, self._aspect, self._rays, self._depth.ravel(), flat)
        image, nearness = np.zeros(shape), np.zeros(shape)
        draw(self._grey, mesh, self._depth, self._aspect, JUMP, image, nearness)
        return image.clip(0, 255), nearness > 0


def continued(image: NDArray[np.uint8], known: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """The image with what is not known filled by means of what is known nearby."""
    if known.all():
        return image
    sigma = 0.1 * image.shape[1]
    shares = cv2.GaussianBlur(known.astype(np.float32), (0, 0), sigma)
    means = cv2.GaussianBlur(np.where(known, image, 0).astype(np.float32), (0, 0), sigma)
    far = float(image[known].mean()) if known.any() else 0.0
    means = np.where(shares > 1e-3, means / np.maximum(shares, 1e-3), far)
    return np.where(known, image, np.rint(means).clip(0, 255)).astype(np.uint8)


@compiled(error_model="numpy")
def project(
    T: NDArray[Any],
    camera: NDArray[Any],
    aspect: float,
    rays: NDArray[Any],
    inverse_depth: NDArray[Any],
    seen: NDArray[Any],
) -> None:
    """Write where points are seen, [image widths] from the middle, and how near, to `seen`.

    Parameters
    ----------
    T : array of shape (4, 4)
        Reference camera to this camera.
    camera : array of shape (5,)
        f, cx, cy, k1, k2.
    aspect : float
    rays : array of shape (n, 2)
    inverse_depth : array of shape (n,)
    seen : array of shape (n, 3)
        Written: x, y, and the inverse depth in this camera; the latter is zero for points that
        are not before the camera.
    """
    f, cx, cy, k1, k2 = camera
    for i in range(rays.shape[0]):
        x, y, q = rays[i, 0], rays[i, 1], inverse_depth[i]
        X = T[0, 0] * x + T[0, 1] * y + T[0, 2] + q * T[0, 3]
        Y = T[1, 0] * x + T[1, 1] * y + T[1, 2] + q * T[1, 3]
        Z = T[2, 0] * x + T[2, 1] * y + T[2, 2] + q * T[2, 3]
        seen[i] = 0.0
        if Z > 0.05:
            px, py = X / Z, Y / Z
            r2 = px * px + py * py
            if 1.0 + r2 * (3.0 * k1 + 5.0 * k2 * r2) > 0.0:
                d = 1.0 + r2 * (k1 + k2 * r2)
                seen[i, 0], seen[i, 1], seen[i, 2] = f * d * px + cx, f * d * py + cy, q / Z


@compiled(error_model="numpy")
def _fill(
    a: NDArray[Any],
    b: NDArray[Any],
    c: NDArray[Any],
    grey_a: float,
    grey_b: float,
    grey_c: float,
    image: NDArray[Any],
    nearness: NDArray[Any],
) -> None:
    """Draw a triangle of corners (column, row, inverse depth) where it is the nearest."""
    area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    if area <= 0.0:  # seen from behind
        return
    height, width = image.shape
    left = max(0, int(np.ceil(min(a[0], b[0], c[0]))))
    right = min(width - 1, int(np.floor(max(a[0], b[0], c[0]))))
    top = max(0, int(np.ceil(min(a[1], b[1], c[1]))))
    bottom = min(height - 1, int(np.floor(max(a[1], b[1], c[1]))))
    for row in range(top, bottom + 1):
        for column in range(left, right + 1):
            wa = ((b[0] - column) * (c[1] - row) - (b[1] - row) * (c[0] - column)) / area
            wb = ((c[0] - column) * (a[1] - row) - (c[1] - row) * (a[0] - column)) / area
            wc = 1.0 - wa - wb
            if wa >= -1e-9 and wb >= -1e-9 and wc >= -1e-9:
                near = wa * a[2] + wb * b[2] + wc * c[2]
                if near > nearness[row, column]:
                    nearness[row, column] = near
                    image[row, column] = wa * grey_a + wb * grey_b + wc * grey_c


@compiled(error_model="numpy")
def draw(
    grey: NDArray[Any],
    seen: NDArray[Any],
    depth: NDArray[Any],
    aspect: float,
    jump: float,
    image: NDArray[Any],
    nearness: NDArray[Any],
) -> None:
    """Draw the reference image as a mesh of triangles between its pixels.

    Parameters
    ----------
    grey : array of shape (height, width)
    seen : array of shape (height, width, 3)
        From `project`.
    depth : array of shape (height, width)
        Inverse depths in the reference camera.
    aspect : float
    jump : float
        Pixels whose inverse depths differ by a larger share belong to different surfaces; nothing
        is known between them.
    image, nearness : arrays of shape (height, width)
        Written where something is seen; `nearness` begins as zeros.
    """
    rows, columns = grey.shape
    height, width = image.shape
    at = np.empty((rows, columns, 3))
    for i in range(rows):
        for j in range(columns):
            at[i, j, 0] = (seen[i, j, 0] + 0.5) * width - 0.5
            at[i, j, 1] = (seen[i, j, 1] / aspect + 0.5) * height - 0.5
            at[i, j, 2] = seen[i, j, 2]
    for i in range(rows - 1):
        for j in range(columns - 1):
            d00, d01, d10, d11 = depth[i, j], depth[i, j + 1], depth[i + 1, j], depth[i + 1, j + 1]
            near, far = max(d00, d01, d10, d11), min(d00, d01, d10, d11)
            before = min(at[i, j, 2], at[i, j + 1, 2], at[i + 1, j, 2], at[i + 1, j + 1, 2]) > 0.0
            if before and near - far < jump * far:
                _fill(
                    at[i, j],
                    at[i, j + 1],
                    at[i + 1, j],
                    grey[i, j],
                    grey[i, j + 1],
                    grey[i + 1, j],
                    image,
                    nearness,
                )
                _fill(
                    at[i + 1, j + 1],
                    at[i + 1, j],
                    at[i, j + 1],
                    grey[i + 1, j + 1],
                    grey[i + 1, j],
                    grey[i, j + 1],
                    image,
                    nearness,
                )
