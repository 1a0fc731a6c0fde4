"""Images of the textured plane, and a robot that carries the camera on an unknown mount."""

import numpy as np
from scipy.spatial.transform import Rotation

from planar import PIVOT, RANGES, planar_images
from planar_cell import SIZE, T_WORLD_REF, Cell
from servoscope.data.images import PoseImageSet
from servoscope.poses import (
    displacements_from_poses,
    inverse_transform,
    poses_from_displacements,
    rigid_transform,
)

RINGS = ((40, 1.0),)

T_FLANGE_CAM = rigid_transform(
    Rotation.from_euler("xyz", [7, -9, 30], degrees=True).as_matrix(), [0.06, -0.02, 0.04]
)
"""Where the camera sits: turned, tilted and off to a side. No model is given it."""


class FlangeCell(Cell):
    """A cell whose robot reports and moves the pose of its flange."""

    T_WORLD_REF = T_WORLD_REF @ inverse_transform(T_FLANGE_CAM)

    def __init__(self, delta_p: np.ndarray, noise: float = 0.0) -> None:
        super().__init__(delta_p, noise)
        self.poses = [poses_from_displacements(self.T_WORLD_REF, delta_p, PIVOT)]

    @property
    def delta_p(self) -> np.ndarray:
        camera = (self.pose @ T_FLANGE_CAM)[None]
        return displacements_from_poses(T_WORLD_REF, camera, PIVOT)[0]


def ring_displacements(rings=RINGS, seed: int = 0) -> np.ndarray:
    """Displacements drawn evenly from rings, in shares of the range."""
    rng = np.random.default_rng(seed)
    return np.vstack([factor * rng.uniform(-1, 1, (n, 6)) for n, factor in rings])


def camera_data(rings=RINGS) -> PoseImageSet:
    """Images with the poses of the camera."""
    delta_p = ring_displacements(rings) * RANGES
    images = planar_images(np.vstack([delta_p, np.zeros(6)]), SIZE, seed=3)
    poses = poses_from_displacements(T_WORLD_REF, delta_p, PIVOT)
    return PoseImageSet(
        images[:-1],
        poses,
        T_WORLD_REF,
        images[-1],
        pivot=PIVOT,
        pivot_ranges=RANGES,
        source={"part": "plane"},
    )
