"""Methods that learn nothing, but answer at once, in the place of those that learn."""

from pathlib import Path

import numpy as np
import pytest

from servoscope.acquisition import AcquisitionConfig
from servoscope.data.images import PoseImageSet
from servoscope.poses import displacements_from_poses, inverse_transform
from servoscope.positioning.interfaces import Estimate
from servoscope.robots.registry import SimulatedRobot
from servoscope.scoreboard.methods import LEARNERS, make_photometric


class Nearest:
    """Predicts the displacement of the training image that is most alike."""

    def __init__(self, data: PoseImageSet) -> None:
        self.data = data
        self.image_shape, self.reference_image = data.image_shape, data.reference_image
        self.pivot, self.reach = data.pivot, data.ranges()
        self.displacements = inverse_transform(data.T_world_ref) @ data.T_world_cam

    @classmethod
    def train(cls, data: PoseImageSet, **_: object) -> "Nearest":
        return cls(data)

    def save(self, folder: Path, *, force: bool) -> None:
        self.data.save(folder)
        (folder / "stand_in").write_text(type(self).__name__)

    @staticmethod
    def load(folder: Path) -> "Nearest":
        kind = {"Nearest": Nearest, "FullStep": FullStep}[(folder / "stand_in").read_text()]
        return kind(PoseImageSet.load(folder))

    def estimate(self, image: np.ndarray, previous: Estimate | None) -> Estimate:
        differences = self.data.images.astype(np.float32) - image
        nearest = int(np.argmin((differences**2).sum(axis=(1, 2))))
        return Estimate(self.displacements[nearest], 0.1 * self.reach, 0.0, "nearest")


class FullStep(Nearest):
    """Photometric servoing that goes all the way that it believes."""

    def __init__(self, data: PoseImageSet) -> None:
        super().__init__(data)
        names = ("image_size", "part", "robot", "translation_mm", "rotation_deg", "pivot_mm")
        acquired = AcquisitionConfig(**{name: data.source[name] for name in names})
        self.servoing = make_photometric(acquired.part, data, acquired, 1.0)

    def estimate(self, image: np.ndarray, previous: Estimate | None) -> Estimate:
        told = self.servoing.estimate(image, None)
        return Estimate(told.displacement, 0.01 * self.reach, 0.0, "full step")


def replace_learners(patch: pytest.MonkeyPatch) -> None:
    """Put stand-ins in the place of the methods that learn."""
    patch.setitem(LEARNERS, "ours", FullStep.train)
    patch.setitem(LEARNERS, "networks", Nearest.train)
    patch.setattr("servoscope.scoreboard.plan.PositioningModel", Nearest)


class Oracle:
    """Knows where the robot's camera is."""

    def __init__(self, robot: SimulatedRobot, reference: SimulatedRobot, pivot: float) -> None:
        self.robot, self.reference, self.pivot = robot, reference, pivot
        self.reference_image = reference.read()
        self.image_shape, self.reach = self.reference_image.shape, np.array([0.1] * 3 + [0.5] * 3)

    def estimate(self, image: np.ndarray, previous: Estimate | None) -> Estimate:
        T_cam_told = inverse_transform(self.reference.true_pose) @ self.reference.pose
        told = self.robot.true_pose @ T_cam_told
        D = inverse_transform(self.reference.pose) @ told
        return Estimate(D, np.full(6, 1e-6), 0.0, "oracle")

    def delta_p(self) -> np.ndarray:
        D = self.estimate(self.reference_image, None).displacement
        return displacements_from_poses(np.eye(4), D[None], self.pivot)[0]
