"""Images at the poses of an acquisition, taken anew with something disturbed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from servoscope.acquisition_config import AcquisitionConfig
from servoscope.errors import InvalidInputError
from servoscope.robots.registry import make_robot
from servoscope.scene.render import render
from servoscope.sensitivity.disturbances import Disturbance, Look

_STREAM = 20013
"""Keeps what disturbances draw apart from what acquisitions draw."""


def take_images(
    config: AcquisitionConfig,
    numbers: Sequence[int],
    disturbance: Disturbance | None = None,
    strength: float = 0.0,
    draw: int = 0,
) -> NDArray[np.uint8]:
    """Images of an acquisition, taken anew with everything as it was but for a disturbance.

    Parameters
    ----------
    config : AcquisitionConfig
        With the robot "free".
    numbers : sequence of int
        Which of its images.
    disturbance : Disturbance, optional
    strength : float
        In the disturbance's unit.
    draw : int
        Another number draws another random disturbance, the same one at every strength.

    Returns
    -------
    ndarray of shape (n, image_size, image_size), uint8
        Without a disturbance, the images of the acquisition, bit for bit.

    Raises
    ------
    InvalidInputError
        If the config asks for another robot, or has no such images.

    Examples
    --------
    >>> take_images(AcquisitionConfig(n_images=5, image_size=32), [1, 4]).shape
    (2, 32, 32)
    """
    if config.robot != "free":
        raise InvalidInputError(
            f"Images are taken anew with the robot free only, got {config.robot!r}."
        )
    if not len(numbers) or not all(0 <= i < config.total() for i in numbers):
        raise InvalidInputError(
            f"numbers must be of the {config.total()} images of the acquisition, got {numbers}."
        )
    poses = config.poses()
    images = []
    for i in numbers:
        look = Look(config.scene())
        if disturbance is not None:
            rng = np.random.default_rng([config.seed, _STREAM, i, draw])
            look = disturbance.change(look, strength, rng)
        images.append(_take(config, i, poses[i], look))
    return np.stack(images)


def _take(
    config: AcquisitionConfig, i: int, T_world_cam: NDArray[np.float64], look: Look
) -> NDArray[np.uint8]:
    rng = config.camera_rng(i)
    robot = make_robot("free", config.scene(), config.repeatability(), rng)
    robot.move_to(T_world_cam)
    image = render(look.scene, robot.true_pose @ look.departure, rng)
    if look.added_noise is None:
        return image
    return np.clip(np.rint(image + look.added_noise), 0, 255).astype(np.uint8)
