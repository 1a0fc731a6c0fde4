"""A camera that moves before a plane with a texture, and what it records."""

from functools import cache

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from servoscope.poses import rigid_transform

WIDTH, HEIGHT, FOCAL, DISTANCE = 64, 48, 70.0, 0.5


@cache
def texture():
    """What the plane shows, (256, 256)."""
    rng = np.random.default_rng(0)
    smooth = cv2.GaussianBlur(rng.normal(size=(256, 256)).astype(np.float32), (0, 0), 4)
    return (127 + 60 * smooth / smooth.std()).astype(np.float32)


def pose_at(times):
    """``T_world_cam`` at some times [s]: it sways sideways and turns about its axis, (n, 4, 4)."""
    t = np.asarray(times, dtype=float)
    x = 0.04 * np.sin(1.7 * t) + 0.02 * np.sin(4.1 * t + 1)
    y = 0.03 * np.sin(2.3 * t + 2) + 0.015 * np.sin(5.3 * t)
    turn = np.column_stack([0 * t, 0 * t, 0.1 * np.sin(1.1 * t)])
    R = Rotation.from_rotvec(turn).as_matrix()
    return rigid_transform(R, np.column_stack([x, y, 0.01 * np.sin(3 * t)]))


def image_at(time, noise=2.0):
    """What the camera sees at a time [s], (HEIGHT, WIDTH) uint8."""
    T = pose_at([time])[0]
    camera = np.diag([FOCAL, FOCAL, 1.0])
    camera[:2, 2] = WIDTH / 2, HEIGHT / 2
    # A point (X, Y) of the plane at z = DISTANCE, in the texture's pixels of 1.5 mm
    R, t = T[:3, :3].T, -T[:3, :3].T @ T[:3, 3]
    plane = np.array([[1, 0, 0], [0, 1, 0], [0, 0, DISTANCE]])
    H = camera @ (R @ plane + np.outer(t, [0, 0, 1]))
    scale = np.array([[1.5e-3, 0, -128 * 1.5e-3], [0, 1.5e-3, -128 * 1.5e-3], [0, 0, 1.0]])
    image = cv2.warpPerspective(texture(), H @ scale, (WIDTH, HEIGHT), flags=cv2.INTER_LINEAR)
    image += np.random.default_rng(int(1e3 * time)).normal(0, noise, image.shape)
    return np.clip(image, 0, 255).round().astype(np.uint8)
