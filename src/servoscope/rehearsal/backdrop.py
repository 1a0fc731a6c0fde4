"""What may be seen beside the reference view: nobody knows, but it is not empty."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from servoscope.keyframe import Keyframe
from servoscope.keyframe.views import View
from servoscope.rehearsal.sampling import sample_at

Array = NDArray[np.float64]

_LEAST = 0.2


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
        image = sample_at(self.view.grey, self.camera, points, cv2.BORDER_REFLECT)
        return np.rint(image).astype(np.uint8)
