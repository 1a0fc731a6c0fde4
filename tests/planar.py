"""Images of a textured plane at known poses, made without the scene that servoscope has."""

import cv2
import numpy as np

from servoscope.data.images import PoseImageSet
from servoscope.poses import poses_from_displacements

PIVOT = 0.55
RANGES = np.array([0.025] * 3 + [np.radians(15)] * 3)


def planar_images(delta_p: np.ndarray, size: int, seed: int) -> np.ndarray:
    """Images of a random smooth texture on a plane at the pivot, seen from displaced poses."""
    noise = np.random.default_rng(seed).normal(size=(96, 96)).astype(np.float32)
    texture = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 6), None, 0, 255, cv2.NORM_MINMAX)
    K = np.array([[1.4 * size, 0, size / 2], [0, 1.4 * size, size / 2], [0, 0, 1]])
    to_plane = np.array([[96 / 0.5, 0, 48], [0, 96 / 0.5, 48], [0, 0, 1]])
    images = []
    for T in poses_from_displacements(np.eye(4), delta_p, PIVOT):
        R, t = T[:3, :3].T, -T[:3, :3].T @ T[:3, 3]
        plane_to_image = K @ np.column_stack([R[:, 0], R[:, 1], PIVOT * R[:, 2] + t])
        H = plane_to_image @ np.linalg.inv(to_plane)
        images.append(cv2.warpPerspective(texture, H, (size, size), borderValue=230))
    return np.array(images).round().astype(np.uint8)


def planar_data_set(n_images: int = 150, size: int = 24, seed: int = 0, **fields) -> PoseImageSet:
    """A data set of a textured plane, small enough to study in seconds."""
    rng = np.random.default_rng(seed)
    delta_p = rng.uniform(-1, 1, (n_images, 6)) * RANGES
    images = planar_images(np.vstack([delta_p, np.zeros(6)]), size, seed)
    return PoseImageSet(
        images[:-1],
        poses_from_displacements(np.eye(4), delta_p, PIVOT),
        np.eye(4),
        images[-1],
        pivot=PIVOT,
        pivot_ranges=RANGES,
        **fields,
    )
