"""The simulated robots, by name.

A further robot needs one line in `ROBOTS`, or an entry point ``servoscope.robots``. It has to be
what `SimulatedRobot` says, stand with its camera where it is put when it is made, and raise
`RobotFaultError` where it cannot go.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servoscope.errors import InvalidInputError
from servoscope.plugins import Registry
from servoscope.robots.free_camera import FreeCamera, Repeatability
from servoscope.scene.scene import T_WORLD_REF, Scene

Array = NDArray[np.float64]


class SimulatedRobot(Protocol):
    """What carries the camera of a simulated cell."""

    @property
    def pose(self) -> Array:
        """Pose of the frame that the robot reports and moves, as it believes it, (4, 4), [m]."""

    @property
    def true_pose(self) -> Array:
        """``T_world_cam`` as it is, (4, 4), [m]."""

    def move(self, displacement: ArrayLike) -> Array:
        """Move by a displacement in that frame; the one that was executed, (4, 4), [m]."""

    def move_to(self, pose: ArrayLike) -> object:
        """Move that frame to a pose (4, 4), [m]; raises `RobotFaultError` if it cannot."""

    def read(self) -> NDArray[np.uint8]:
        """The image from where the camera is."""


class LateImages:
    """A robot whose camera gives the image of `late` reads ago; the first ones are of where it is
    now.
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


Maker = Callable[[Scene, ArrayLike, Repeatability, np.random.Generator | None], SimulatedRobot]


def _arm(
    scene: Scene,
    T_world_cam: ArrayLike,
    repeatability: Repeatability,
    rng: np.random.Generator | None,
) -> SimulatedRobot:
    from servoscope.robots.arm import Arm

    return Arm(scene, T_world_cam, repeatability, rng)


def _checked(name: str, maker: Any) -> Maker:
    if not callable(maker):
        raise InvalidInputError(f"the robot {name!r} must be callable, got {repr(maker)[:80]}")
    return cast(Maker, maker)


ROBOTS: Registry[Maker] = Registry("servoscope.robots", {"free": FreeCamera, "arm": _arm}, _checked)
"""Called with a scene, the pose of the camera, the repeatability and a random generator or None,
they make a robot."""


def check_robot(name: str) -> str:
    """`name` itself, if it is one of `ROBOTS`.

    Raises
    ------
    InvalidInputError
        If it is not.
    """
    if name not in ROBOTS:
        raise InvalidInputError(f"robot must be one of {', '.join(sorted(ROBOTS))}, got {name!r}.")
    return name


def make_robot(
    name: str,
    scene: Scene,
    repeatability: Repeatability | None = None,
    rng: np.random.Generator | None = None,
    T_world_cam: ArrayLike = T_WORLD_REF,
) -> SimulatedRobot:
    """A robot of `ROBOTS` that stands with its camera at a pose, [m], by default at the reference.

    It comes to rest nowhere but where it is sent by default; without `rng` neither motion nor
    sensor has errors.

    Examples
    --------
    >>> make_robot("free", Scene(image_size=32)).read().shape
    (32, 32)
    """
    maker = ROBOTS[check_robot(name)]
    return maker(scene, T_world_cam, repeatability or Repeatability(), rng)
