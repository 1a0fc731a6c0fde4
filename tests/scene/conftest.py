"""What the tests of the cell share: small scenes, and OpenCV's opinion of where things are seen."""

from collections.abc import Callable

import cv2
import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

from servoscope.poses import inverse_transform
from servoscope.scene.cylinder_head import CylinderHead
from servoscope.scene.mesh import Mesh
from servoscope.scene.scene import Scene

Array = NDArray[np.float64]


@pytest.fixture(scope="session")
def head() -> Mesh:
    """The mesh of the part."""
    return CylinderHead().mesh()


@pytest.fixture
def see() -> Callable[[Scene, ArrayLike, ArrayLike], Array]:
    """Pixels at which OpenCV says that points of the world are seen."""

    def project(scene: Scene, T_world_cam: ArrayLike, points: ArrayLike) -> Array:
        T_cam_world = inverse_transform(T_world_cam)
        rvec, _ = cv2.Rodrigues(T_cam_world[:3, :3])
        K = scene.lens.camera_matrix(scene.image_size)
        distortion = np.array([*scene.lens.distortion, 0.0, 0.0])
        points = np.asarray(points, dtype=float).reshape(-1, 1, 3)
        return cv2.projectPoints(points, rvec, T_cam_world[:3, 3], K, distortion)[0][:, 0]

    return project
