"""A camera that flies: it goes where it is sent, but for the error that a robot would make."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from servoscope.errors import InvalidInputError
from servoscope.poses import as_rigid, rigid_transform
from servoscope.scene.render import render
from servoscope.scene.scene import T_WORLD_REF, Scene

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Repeatability:
    """How far from where it was sent a robot comes to rest:

    standard deviations along and about each axis, [m] and [rad].
    """

    position: float = 0.0
    rotation: float = 0.0

    def __post_init__(self) -> None:
        for name in ("position", "rotation"):
            value = getattr(self, name)
            if not 0 <= value < np.inf:
                raise InvalidInputError(f"{name} must be finite and not negative, got {value}.")

    def disturb(self, T_world_cam: ArrayLike, rng: np.random.Generator) -> Array:
        """The pose that is reached when `T_world_cam` is commanded."""
        error = rng.standard_normal(6)
        rotation = Rotation.from_rotvec(self.rotation * error[3:]).as_matrix()
        return np.asarray(T_world_cam) @ rigid_transform(rotation, self.position * error[:3])


class FreeMotion:
    """What moves freely from exactly a pose, [m], and comes to rest near where it is sent."""

    def __init__(
        self,
        T_world_cam: ArrayLike,
        repeatability: Repeatability,
        rng: np.random.Generator | None,
    ) -> None:
        self.repeatability, self.rng = repeatability, rng
        self._commanded = self._reached = np.array(T_world_cam, dtype=float)

    @property
    def pose(self) -> Array:
        """``T_world_cam`` as the robot believes it, (4, 4), [m]: where it was last sent."""
        return self._commanded.copy()

    @property
    def true_pose(self) -> Array:
        """``T_world_cam`` as it is, (4, 4), [m]: what a simulation knows and a robot does not."""
        return self._reached.copy()

    def move(self, displacement: ArrayLike) -> Array:
        """Move by a displacement (4, 4) in the camera's own frame, [m].

        Returns what was executed as the robot believes: the displacement it was sent.
        """
        executed = as_rigid(displacement, "displacement")
        self.move_to(self._commanded @ executed)
        return executed

    def move_to(self, T_world_cam: ArrayLike) -> None:
        """Move to a pose (4, 4), [m]; raises what `move` raises."""
        self._commanded = self._reached = as_rigid(T_world_cam, "T_world_cam")
        if self.rng is not None:
            self._reached = self.repeatability.disturb(self._commanded, self.rng)


class FreeCamera(FreeMotion):
    """The camera of a simulated cell, moved freely from where it starts exactly.

    Without `rng` neither motion nor sensor has errors.

    Examples
    --------
    >>> camera = FreeCamera(Scene(image_size=32))
    >>> executed = camera.move(rigid_transform(np.eye(3), [0.0, 0.0, 0.1]))
    >>> round(float(camera.pose[2, 3]), 3), camera.read().shape
    (0.45, (32, 32))
    """

    def __init__(
        self,
        scene: Scene,
        T_world_cam: ArrayLike = T_WORLD_REF,
        repeatability: Repeatability | None = None,
        rng: np.random.Generator | None = None,
    ) -> None:
        super().__init__(T_world_cam, repeatability or Repeatability(), rng)
        self.scene = scene

    def read(self) -> NDArray[np.uint8]:
        """The image from where the camera is, (image_size, image_size)."""
        return render(self.scene, self._reached, self.rng)
