"""Images of a displaced camera over a textured plate on a white table, made in an instant."""

from __future__ import annotations

import cv2
import numpy as np

from servoscope.poses import inverse_transform, poses_from_displacements

PIVOT = 0.55
RANGES = np.array([0.025] * 3 + [np.radians(15.0)] * 3)
PLATE_SIZE = 0.30
"""Side of the plate, [m]; the view at the pivot is 0.39 m wide."""


def displaced_images(n_images: int, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Images (n_images, size, size), uint8, with sensor noise, and their delta_p (n_images, 6)."""
    rng = np.random.default_rng(0)
    noise = cv2.GaussianBlur(rng.normal(size=(size, size)), (0, 0), size / 12)
    plate = cv2.normalize(noise, None, 0, 170, cv2.NORM_MINMAX).astype(np.uint8)
    delta_p = rng.uniform(-1, 1, (n_images, 6)) * RANGES
    images = np.empty((n_images, size, size), np.uint8)
    poses = poses_from_displacements(np.eye(4), delta_p, PIVOT)
    for image, T_cam_world in zip(images, inverse_transform(poses), strict=True):
        H = _homography(T_cam_world, size)
        view = cv2.warpPerspective(plate, H, (size, size), borderValue=200)
        image[:] = np.clip(view + rng.normal(0, 2, view.shape), 0, 255)
    return images, delta_p


def _homography(T_cam_world: np.ndarray, size: int) -> np.ndarray:
    """From pixels of the plate to pixels of the image."""
    K = np.array([[1.4 * size, 0, size / 2], [0, 1.4 * size, size / 2], [0, 0, 1]])
    metres = PLATE_SIZE / size
    x, y = np.eye(4)[:2] * metres
    corner = np.array([-PLATE_SIZE / 2, -PLATE_SIZE / 2, PIVOT, 1])
    return K @ (T_cam_world @ np.column_stack([x, y, corner]))[:3]
