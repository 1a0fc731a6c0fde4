"""Images of two printed plates, one before the other, made by homographies alone."""

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from servoscope.poses import inverse_transform, rigid_transform

WIDTH, HEIGHT, FOCAL = 176, 112, 1.3
"""Of the images, [px], and of the lens, [image widths]."""

FAR, NEAR = 0.60, 0.48
"""Where the plates are, [m]."""

MOUNT = rigid_transform(
    Rotation.from_euler("zyx", [75.0, -12.0, 160.0], degrees=True).as_matrix(), [0.04, -0.06, 0.05]
)
"""Camera coordinates to those of the flange."""


def plate(seed: int, sigma: float) -> np.ndarray:
    rng = np.random.default_rng(seed)
    fine, coarse = (
        cv2.GaussianBlur(rng.normal(size=(480, 480)).astype(np.float32), (0, 0), s)
        for s in (sigma, 5 * sigma)
    )
    return cv2.normalize(
        fine / fine.std() + 2 * coarse / coarse.std(), None, 20, 235, cv2.NORM_MINMAX
    )


PLATES = ((FAR, 0.9, plate(0, 4.0)), (NEAR, 0.16, plate(1, 6.0)))
"""Distance and side of each plate, [m], and what is printed on it."""


def picture(T_ref_cam: np.ndarray) -> np.ndarray:
    """What a camera sees, T_ref_cam from where it stands square before the plates."""
    K = np.array(
        [[FOCAL * WIDTH, 0, WIDTH / 2 - 0.5], [0, FOCAL * WIDTH, HEIGHT / 2 - 0.5], [0, 0, 1]]
    )
    T = inverse_transform(T_ref_cam)
    image = np.full((2 * HEIGHT, 2 * WIDTH), 128.0, np.float32)
    twice = np.array([[2, 0, 0.5], [0, 2, 0.5], [0, 0, 1.0]])
    for distance, side, print_ in PLATES:
        pixel = side / print_.shape[0]
        on_plate = np.array(
            [[pixel, 0, -side / 2], [0, pixel, -side / 2], [0, 0, distance], [0, 0, 1]]
        )
        H = twice @ K @ (T @ on_plate)[:3]
        size = image.shape[::-1]
        drawn = cv2.warpPerspective(print_, H, size)
        there = cv2.warpPerspective(np.ones_like(print_), H, size)
        image = there * drawn + (1 - there) * image
    return cv2.resize(image, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)


def poses_about(n: int, seed: int, *, turns: bool = True, moves: bool = True) -> np.ndarray:
    """Displacements of the camera, shape (n, 4, 4): about a point on the plates, or on the spot."""
    rng = np.random.default_rng(seed)
    R = Rotation.from_euler("xyz", rng.uniform(-12, 12, (n, 3)) * turns, degrees=True).as_matrix()
    about = rigid_transform(R, rng.uniform(-0.02, 0.02, (n, 3)))
    P = rigid_transform(np.eye(3), [0, 0, 0.55])
    return P @ about @ inverse_transform(P) if moves else rigid_transform(R, np.zeros(3))


def photographs(displacements: np.ndarray, seed: int, noise: float = 1.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    images = np.stack([picture(D) for D in displacements])
    return np.clip(images + noise * rng.normal(size=images.shape), 0, 255).round().astype(np.uint8)


def reported(displacements: np.ndarray) -> np.ndarray:
    """The same displacements in the frame of the flange."""
    return MOUNT @ displacements @ inverse_transform(MOUNT)
