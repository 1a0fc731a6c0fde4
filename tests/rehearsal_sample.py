"""A small keyframe model of a plate, made by hand: nothing is fitted."""

import cv2
import numpy as np

from servoscope.keyframe import CameraModel, Keyframe
from servoscope.poses import poses_from_displacements
from servoscope.positioning import KeyframeModel

WIDTH, HEIGHT, PIVOT = 128, 96, 0.5
RANGES = np.array([0.015] * 3 + [np.radians(5.0)] * 3)


def plate() -> np.ndarray:
    noise = np.random.default_rng(0).normal(size=(HEIGHT, WIDTH))
    coarse, fine = (cv2.GaussianBlur(noise, (0, 0), s) for s in (8, 3))
    texture = coarse / coarse.std() + fine / fine.std()
    return cv2.normalize(texture, None, 20, 235, cv2.NORM_MINMAX).astype(np.uint8)


def displacements(n: int = 5, seed: int = 1) -> np.ndarray:
    delta_p = np.random.default_rng(seed).uniform(-1, 1, (n, 6)) * RANGES
    return poses_from_displacements(np.eye(4), delta_p, PIVOT)


def keyframe(relief: np.ndarray | None = None, **changes) -> Keyframe:
    flat = np.full((HEIGHT // 2, WIDTH // 2), 1 / PIVOT, np.float32)
    values = {
        "reference_image": plate(),
        "camera": CameraModel(1.5),
        "mount": np.eye(4),
        "inverse_depth": flat if relief is None else relief.astype(np.float32),
        "trust": np.ones_like(flat),
        "displacements": displacements(),
        "covariance": np.zeros((20, 20)),
        "model_error": np.zeros(6),
        "pivot": PIVOT,
        "residual": 0.3,
        "noise": 1.0,
    }
    return Keyframe(**values | changes)


def model(**changes) -> KeyframeModel:
    return KeyframeModel(keyframe(**changes), reach=RANGES)
