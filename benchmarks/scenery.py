"""Images with something like the content of an acquisition, made in an instant."""

from __future__ import annotations

import cv2
import numpy as np


def textured_images(n_images: int, size: int) -> np.ndarray:
    """A smooth random texture seen from displaced places, with sensor noise; uint8."""
    rng = np.random.default_rng(0)
    noise = cv2.GaussianBlur(rng.normal(size=(2 * size, 2 * size)), (0, 0), size / 20)
    texture = cv2.normalize(noise, None, 0, 255, cv2.NORM_MINMAX).astype(np.float32)
    images = np.empty((n_images, size, size), np.uint8)
    for image in images:
        angle, zoom = rng.uniform(-15, 15), rng.uniform(0.9, 1.1)
        A = cv2.getRotationMatrix2D((size, size), angle, zoom)
        A[:, 2] += rng.uniform(-0.1, 0.1, 2) * size - size / 2
        view = cv2.warpAffine(texture, A, (size, size), flags=cv2.INTER_LINEAR)
        image[:] = np.clip(view + rng.normal(0, 2, view.shape), 0, 255)
    return images
