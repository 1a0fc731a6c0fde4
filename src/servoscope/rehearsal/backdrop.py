"""What may be seen beside the reference view: nobody knows, but it is not empty."""

from __future__ import annotations

from collections.abc import Iterable
from copy import copy
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from servoscope.keyframe import Keyframe
from servoscope.keyframe.camera import CameraModel
from servoscope.keyframe.levels import View, prepare
from servoscope.rehearsal.sampling import sample_at

Array = NDArray[np.float64]

_LEAST = 0.2
_WIDER = 2
_NEAREST, _WHOLLY = 0.05, 0.99


class Backdrop:
    """A plane through the relief, on which the reference image goes on, mirrored at its edges.

    So it moves as a part does when the camera moves, has the texture and the grey levels of the
    view, joins it without an edge, and shows nothing that the keyframe could be aligned with.

    Parameters
    ----------
    keyframe : Keyframe
    width : int
        Of its images, [px].
    """

    def __init__(self, keyframe: Keyframe, width: int) -> None:
        self.camera = keyframe.camera
        self.view = View.of(keyframe.reference_image, width, 0.0)
        rays, _ = self.camera.rays(self.view.points)
        self.rays = np.column_stack([rays, np.ones(len(rays))])
        depth = self.view.resize(keyframe.inverse_depth).ravel().astype(float)
        trust = self.view.resize(keyframe.trust).ravel().astype(float) + 1e-3
        rows = np.sqrt(trust)[:, None]
        self.plane = np.linalg.lstsq(self.rays * rows, depth * rows[:, 0], rcond=None)[0]
        self._image, self._image_camera = self.view.grey, self.camera

    def shown_in(self, images: Iterable[tuple[NDArray[Any], Array]]) -> Backdrop:
        """The backdrop as other images show it beside the reference view.

        Parameters
        ----------
        images : iterable of (ndarray, ndarray)
            Real images, each with the motion of the camera to where it was taken (4, 4); the
            earlier come first.

        Returns
        -------
        Backdrop
            Still mirrored where none of them shows it.
        """
        height, width = self.view.shape
        f, cx, cy = self.camera.values[:3] / _WIDER
        wide = CameraModel(f, cx, cy)
        canvas = View.of(np.zeros((_WIDER * height, _WIDER * width)), _WIDER * width, 0.0)
        rays = np.column_stack([wide.rays(canvas.points)[0], np.ones(len(canvas.points))])
        slope = np.maximum(rays @ self.plane, _LEAST * self.plane[2])
        points = rays / slope[:, None]
        mirrored = points.reshape(*canvas.shape, 3)
        grey = sample_at(self.view.grey, self.camera, mirrored, cv2.BORDER_REFLECT)
        unknown = np.ones(canvas.shape, bool)
        for image, T in ((self.view.grey, np.eye(4)), *images):
            at = (points @ T[:3, :3].T + T[:3, 3]).reshape(*canvas.shape, 3)
            small = prepare(image, width, 0.0)
            shown = sample_at(np.ones_like(small), self.camera, at, cv2.BORDER_CONSTANT) > _WHOLLY
            shown &= unknown & (at[..., 2] > _NEAREST)
            grey[shown] = sample_at(small, self.camera, at, cv2.BORDER_CONSTANT)[shown]
            unknown &= ~shown
        other = copy(self)
        other._image, other._image_camera = grey, wide
        return other

    def render(self, T: Array) -> NDArray[np.uint8]:
        """What is seen of it after a motion of the camera.

        A point ``X`` of the plane has ``n . X = 1`` in the reference camera; the ray ``r`` of a
        camera at ``X' = R X + t`` meets it at ``X' = s r`` with
        ``s = (1 + n . R^T t) / (n . R^T r)``.

        Parameters
        ----------
        T : ndarray of shape (4, 4)
            Reference camera to this camera.
        """
        R, t = T[:3, :3], T[:3, 3]
        slope = self.rays @ (R @ self.plane)
        s = (1 + self.plane @ R.T @ t) / np.maximum(slope, _LEAST * self.plane[2])
        points = ((s[:, None] * self.rays - t) @ R).reshape(*self.view.shape, 3)
        image = sample_at(self._image, self._image_camera, points, cv2.BORDER_REFLECT)
        return np.rint(image).astype(np.uint8)
