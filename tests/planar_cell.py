"""A cell to move in: a textured plane, an honest robot, and an estimator that knows the truth."""

import threading
from collections.abc import Callable

import numpy as np

from planar import PIVOT, RANGES, planar_images
from servoscope.poses import (
    displacements_from_poses,
    inverse_transform,
    is_rigid,
    poses_from_displacements,
)
from servoscope.positioning.interfaces import Estimate

SIZE = 48
T_WORLD_REF = poses_from_displacements(np.eye(4), np.array([0.3, -0.2, 0.9, 0.1, 0.2, 2.0]), 0.4)


class Cell:
    """Camera and robot in one; it keeps every pose that it was at."""

    def __init__(self, delta_p: np.ndarray, noise: float = 0.0) -> None:
        self.poses = [poses_from_displacements(T_WORLD_REF, delta_p, PIVOT)]
        self.noise = noise
        self.rng = np.random.default_rng(0)

    @property
    def pose(self) -> np.ndarray:
        return self.poses[-1]

    @property
    def delta_p(self) -> np.ndarray:
        return displacements_from_poses(T_WORLD_REF, self.pose[None], PIVOT)[0]

    def move(self, displacement: np.ndarray) -> np.ndarray:
        assert is_rigid(displacement)
        self.poses.append(self.pose @ displacement)
        return displacement

    def read(self) -> np.ndarray:
        image = planar_images(self.delta_p[None], SIZE, seed=3)[0]
        noise = self.rng.normal(0, self.noise, image.shape) if self.noise else 0.0
        return np.clip(image + noise, 0, 255).round().astype(np.uint8)


class Stoppable(Cell):
    """A cell that counts its moves and stops, and takes `seconds` to move unless it is stopped."""

    def __init__(self, delta_p: np.ndarray, noise: float = 0.0, seconds: float = 0.0) -> None:
        super().__init__(delta_p, noise)
        self.sent, self.stops, self.seconds = 0, 0, seconds
        self.is_moving, self._stopped = threading.Event(), threading.Event()

    def move(self, displacement: np.ndarray) -> np.ndarray:
        self.sent += 1
        self.is_moving.set()
        if self._stopped.wait(self.seconds):
            raise RuntimeError("stopped on the way")
        return super().move(displacement)

    def stop(self) -> None:
        self.stops += 1
        self._stopped.set()


class Oracle:
    """Sees where the cell's camera is, and tells it changed by ``distort(delta_p)``."""

    image_shape = (SIZE, SIZE)
    reference_image = planar_images(np.zeros((1, 6)), SIZE, seed=3)[0]
    pivot = PIVOT
    reach = RANGES

    def __init__(
        self,
        cell: Cell,
        distort: Callable[[np.ndarray], np.ndarray] = lambda delta_p: delta_p,
        std: float = np.nan,
        novelty: float = np.nan,
    ) -> None:
        self.cell, self.distort, self.novelty = cell, distort, novelty
        self.std = std * RANGES

    def estimate(self, image: np.ndarray, previous: Estimate | None) -> Estimate:
        believed = poses_from_displacements(np.eye(4), self.distort(self.cell.delta_p), PIVOT)
        return Estimate(believed, self.std, self.novelty, "oracle")


def distance_from_reference(cell: Cell) -> float:
    return float(np.linalg.norm((inverse_transform(T_WORLD_REF) @ cell.pose)[:3, 3]))
