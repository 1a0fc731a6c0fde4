"""The methods that are compared: those that learn, and photometric servoing.

Each has its own settings in the one loop.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.acquisition import AcquisitionConfig
from servoscope.data.images import PoseImageSet
from servoscope.poses import inverse_transform
from servoscope.positioning import Estimate, Estimator, LoopSettings
from servoscope.positioning.feature_model import FeatureModel
from servoscope.positioning.model import PositioningModel
from servoscope.positioning.photometric import PhotometricEstimate, PhotometricServoing
from servoscope.positioning.training import train
from servoscope.robots.free_camera import Repeatability
from servoscope.scene.render import render_depth
from servoscope.scoreboard.cell import mount_of, robot_at_reference

Array = NDArray[np.float64]


def train_networks(data: PoseImageSet, **options: Any) -> FeatureModel:
    """The paper's networks on its geometric moments, looked at again after every move."""
    return FeatureModel.train(
        data, families=("moments",), regressor="levenberg_marquardt", **options
    )


LEARNERS: dict[str, Callable[..., PositioningModel]] = {"ours": train, "networks": train_networks}
"""What makes a model of a `PoseImageSet`, by method; takes ``seed``, ``n_jobs`` and ``on_progress``
by name."""

METHODS = (*LEARNERS, "photometric")

MOST_MOVES = 12
MOST_MOVES_PHOTOMETRIC = 200


class Mounted:
    """Estimates of the camera's displacement, in the frame of the flange.

    Parameters
    ----------
    servoing : PhotometricServoing
    T_flange_cam : ndarray of shape (4, 4)
        Where the camera sits, [m].
    pivot : float
        That of the flange, [m].

    Notes
    -----
    With the mount M, the flange's displacement is ``M D M^-1`` where the camera's is D.
    """

    def __init__(self, servoing: PhotometricServoing, T_flange_cam: Array, pivot: float) -> None:
        self.servoing, self.T_flange_cam, self.pivot = servoing, T_flange_cam, pivot
        self.image_shape, self.reach = servoing.image_shape, servoing.reach
        self.reference_image = servoing.reference_image

    def estimate(self, image: NDArray[np.uint8], previous: Estimate | None) -> PhotometricEstimate:
        """Where the flange was when an image was taken, and the move that the law makes of it."""
        seen = self.servoing.estimate(image, previous)
        M, M_inv = self.T_flange_cam, inverse_transform(self.T_flange_cam)
        return replace(seen, displacement=M @ seen.displacement @ M_inv, step=M @ seen.step @ M_inv)


def make_photometric(
    scene: str, data: PoseImageSet, acquired: AcquisitionConfig, depth_factor: float
) -> Estimator:
    """Photometric servoing that is given the camera, its mount and the depth of every pixel, by a
    factor. The reference image of the data is what is aimed at; its range bounds the workspace.
    """
    robot = robot_at_reference(scene, acquired.robot, acquired.image_size)
    seen = acquired.scene()
    K = seen.lens.camera_matrix(acquired.image_size)
    servoing = PhotometricServoing(
        data.reference_image,
        K[0, 0],
        (K[0, 2], K[1, 2]),
        depth_factor * render_depth(seen, robot.true_pose),
        acquired.pivot_ranges(),
        1e-3 * acquired.pivot_mm,
        distortion=seen.lens.distortion,
    )
    T_reported_cam = mount_of(robot)
    if np.allclose(T_reported_cam, np.eye(4)):
        return servoing
    return Mounted(servoing, T_reported_cam, data.pivot)


def loop_settings(method: str, repeatability: Repeatability) -> LoopSettings:
    """How the loop is set for a method and a robot.

    Photometric servoing keeps to its own law: many moves, a wide workspace, image errors that may
    rise on the way, and displacements that are only directions.
    """
    settings: dict[str, Any] = {"max_moves": MOST_MOVES}
    if method == "photometric":
        settings = {
            "max_moves": MOST_MOVES_PHOTOMETRIC,
            "growth": 2.0,
            "workspace_margin": 2.0,
            "largest_innovation": None,
        }
    return LoopSettings(
        repeatability_mm=1e3 * repeatability.position,
        repeatability_deg=float(np.degrees(repeatability.rotation)),
        read_timeout_s=None,
        move_timeout_s=None,
        **settings,
    )
