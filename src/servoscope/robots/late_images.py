"""A camera whose images come late."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.robots.registry import SimulatedRobot

Array = NDArray[np.float64]


class LateImages:
    """A robot whose camera gives the image of some reads ago.

    Parameters
    ----------
    robot : SimulatedRobot
    late : int
        How many reads old an image is; the first ones are of where the robot is now.
    """

    def __init__(self, robot: SimulatedRobot, late: int) -> None:
        self._robot = robot
        self._images = [robot.read() for _ in range(late)]

    @property
    def pose(self) -> Array:
        """See `SimulatedRobot`."""
        return self._robot.pose

    @property
    def true_pose(self) -> Array:
        """See `SimulatedRobot`."""
        return self._robot.true_pose

    def move(self, displacement: ArrayLike) -> Array:
        """See `SimulatedRobot`."""
        return self._robot.move(displacement)

    def move_to(self, pose: ArrayLike) -> object:
        """See `SimulatedRobot`."""
        return self._robot.move_to(pose)

    def read(self) -> NDArray[np.uint8]:
        """The image of some reads ago."""
        self._images.append(self._robot.read())
        return self._images.pop(0)
