"""The trained model brings the camera back, wherever it sits on the robot."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from planar import PIVOT, RANGES, planar_images
from planar_cell import SIZE, T_WORLD_REF, Cell, Oracle
from planar_model import FLANGE_RANGES, T_FLANGE_CAM, FlangeCell, camera_model, flange_model
from servoscope.poses import (
    displacements_from_poses,
    pose_error,
    poses_from_displacements,
    rigid_transform,
)
from servoscope.positioning import LoopSettings, Positioner, PositioningModel
from servoscope.positioning.guard import novelty_fault
from servoscope.positioning.model import LevelEstimate
from servoscope.scene.disturbances import Disturbances

pytestmark = pytest.mark.slow

ENDED_MM, ENDED_DEG = 1.0, 0.1


def starts(share: float, n: int, seed: int = 7) -> np.ndarray:
    """Displacements that no model was trained on, in shares of the range."""
    return share * np.random.default_rng(seed).uniform(-1, 1, (n, 6))


def run(model, cell, camera=None):
    """A run of the loop; what came of it, and whether its end is where it should be."""
    result = Positioner(model).run(cell, cell if camera is None else camera)
    return result, cell


def is_there(T_world_cam: np.ndarray) -> bool:
    distance, angle = pose_error(T_WORLD_REF, T_world_cam)
    return bool(1e3 * distance < ENDED_MM and np.degrees(angle) < ENDED_DEG)


def test_from_anywhere_in_the_range_it_arrives_in_a_few_moves() -> None:
    runs = [run(camera_model(), Cell(p * RANGES)) for p in starts(0.9, 12)]
    assert [result.status for result, _ in runs] == ["converged"] * 12
    assert all(is_there(cell.pose) for _, cell in runs)
    assert np.median([result.moves for result, _ in runs]) <= 7


class DisturbedCamera:
    """Sees what a cell sees through disturbances."""

    def __init__(self, cell: Cell, disturbances: Disturbances) -> None:
        self.cell, self.disturbances = cell, disturbances
        self.rng = np.random.default_rng(0)

    def read(self) -> np.ndarray:
        return self.disturbances.disturb(self.cell.read(), self.rng)


@pytest.mark.parametrize("disturbances", [{"gain": 0.8}, {"noise": 2.0}])
def test_in_disturbed_images_it_arrives(disturbances) -> None:
    for p in starts(0.5, 6):
        cell = Cell(p * RANGES)
        camera = DisturbedCamera(cell, Disturbances.only(**disturbances))
        result, _ = run(camera_model(), cell, camera)
        distance, angle = pose_error(T_WORLD_REF, cell.pose)
        assert result.status == "converged"
        assert distance < 4e-3
        assert angle < np.radians(0.4)


def test_in_noise_that_hides_the_reference_it_does_not_claim_to_have_arrived() -> None:
    for p in starts(0.5, 6):
        cell = Cell(p * RANGES)
        camera = DisturbedCamera(cell, Disturbances.only(noise=25.0))
        result, _ = run(camera_model(), cell, camera)
        error = np.abs(cell.delta_p) / np.maximum(result.predicted_error, 1e-9)
        assert result.status != "converged" or np.sqrt(np.mean(error**2)) < 5


class OtherTexture:
    """Sees another texture, whatever the robot does."""

    def __init__(self, seed: int) -> None:
        self.image = planar_images(starts(0.5, 1, seed) * RANGES, SIZE, seed)[0]

    def read(self) -> np.ndarray:
        return self.image


def test_another_part_is_refused_before_a_move_is_made() -> None:
    cameras = [OtherTexture(seed) for seed in range(20, 40)]
    results = [run(camera_model(), Cell(0.3 * RANGES), camera)[0] for camera in cameras]
    refused = [result for result in results if (result.status, result.moves) == ("abstained", 0)]
    assert len(refused) >= 18
    assert all("unlike the training images" in result.message for result in refused)


def test_the_mount_is_far_from_none() -> None:
    distance, angle = pose_error(np.eye(4), T_FLANGE_CAM)
    assert distance > 0.06
    assert angle > np.radians(30)


def test_with_the_camera_on_an_unknown_mount_it_arrives_all_the_same() -> None:
    cells = [FlangeCell(p * FLANGE_RANGES) for p in starts(0.9, 12)]
    runs = [run(flange_model(), cell) for cell in cells]
    assert [result.status for result, _ in runs] == ["converged"] * 12
    assert all(is_there(cell.pose @ T_FLANGE_CAM) for cell in cells)
    assert np.median([result.moves for result, _ in runs]) <= 7


def test_told_the_poses_of_another_frame_than_that_of_training_it_is_stopped_or_fails() -> None:
    """What the mount test would be if the mount did not matter anyway."""
    cells = [FlangeCell(p * FLANGE_RANGES) for p in starts(0.9, 6)]
    moves = [run(camera_model(), cell)[0].moves for cell in cells]
    there = [is_there(cell.pose @ T_FLANGE_CAM) for cell in cells]
    assert not (np.array(there) & (np.array(moves) <= 6)).any()


def test_what_it_believes_is_left_is_about_what_is_left() -> None:
    shares = []
    for p in starts(0.5, 10, seed=3):
        result, cell = run(camera_model(), Cell(p * RANGES, noise=2.0))
        assert result.status == "converged"
        shares.append((result.remaining - cell.delta_p) / result.predicted_error)
    rms = np.sqrt(np.mean(np.square(shares)))
    assert 0.2 < rms < 5


def _turned(image: np.ndarray, degrees: float) -> np.ndarray:
    turn = cv2.getRotationMatrix2D(((SIZE - 1) / 2, (SIZE - 1) / 2), degrees, 1)
    return cv2.warpAffine(image, turn, (SIZE, SIZE), borderMode=cv2.BORDER_REFLECT)


def test_foreign_images_are_refused_by_their_similarity_whatever_the_relative_limit() -> None:
    model, limits = camera_model(), LoopSettings()
    model = replace(model, levels=[replace(level, unlikeness_limit=9.0) for level in model.levels])
    own = [Cell(p * RANGES, noise=2.0).read() for p in starts(1.0, 60)]
    others = [planar_images(starts(0.5, 1, s) * RANGES, SIZE, s)[0] for s in range(20, 80)]
    turned = [_turned(image, degrees) for image in own[:30] for degrees in (60, 180)]

    def refused(images) -> float:
        estimates = [model.estimate(image) for image in images]
        return float(np.mean([novelty_fault(e, limits) is not None for e in estimates]))

    assert refused(own) <= 0.01
    assert refused(others) >= 0.95
    assert refused(turned) >= 0.9


def test_an_overexposed_camera_does_not_claim_to_have_arrived_where_it_has_not() -> None:
    class Overexposed(Cell):
        def read(self):
            return np.clip(self.gain * super().read(), 0, 255).astype(np.uint8)

    for gain in (1.3, 1.5, 1.8, 2.2):
        for p in starts(0.5, 3):
            cell = Overexposed(p * RANGES, noise=1.0)
            cell.gain = gain
            result, _ = run(camera_model(), cell)
            distance, _ = pose_error(T_WORLD_REF, cell.pose)
            assert result.status != "converged" or distance < 3e-3


def test_the_reference_image_has_arrived_whatever_the_estimate(monkeypatch) -> None:
    model = camera_model()
    away = LevelEstimate(
        rigid_transform(np.eye(3), [0.042, 0, 0]), RANGES, 0.5, "networks", is_finest=False
    )
    monkeypatch.setattr(PositioningModel, "estimate", lambda self, image, previous=None: away)
    cell = Cell(np.zeros(6), noise=2.0)
    result, _ = run(model, cell)
    assert (result.status, result.moves) == ("converged", 0)
    assert "equals the reference" in result.message


def test_a_tolerance_that_the_scatter_of_the_robot_cannot_meet_ends_as_near_as_it_allows() -> None:
    class Scattering(Cell):
        def move(self, displacement):
            reported = super().move(displacement)
            scatter = np.array([1e-4] * 3 + [np.radians(0.01)] * 3) * self.rng.normal(size=6)
            self.off = poses_from_displacements(np.eye(4), scatter, 0.0)
            return reported

        off = np.eye(4)

        @property
        def delta_p(self):
            return displacements_from_poses(T_WORLD_REF, (self.pose @ self.off)[None], PIVOT)[0]

    ends = []
    for p in starts(0.5, 8):
        cell = Scattering(p * RANGES)
        oracle = Oracle(cell, std=1e-5)
        oracle.reference_image = camera_model().reference_image
        settings = LoopSettings(tolerance_mm=0.05, tolerance_deg=0.005)
        ends.append(Positioner(oracle, settings).run(cell, cell))
    assert {end.status for end in ends} <= {"limited", "converged"}
    assert any("As near as the robot allows" in end.message for end in ends)
    free = [replace(settings, tolerance_mm=None, tolerance_deg=None)] * 2
    for settings, p in zip(free, starts(0.5, 2), strict=True):
        cell = Scattering(p * RANGES)
        assert Positioner(Oracle(cell, std=1e-5), settings).run(cell, cell).status == "converged"


def test_tolerances_of_single_dofs_are_met_or_said_to_be_missed() -> None:
    cell = Cell(starts(0.5, 1)[0] * RANGES)
    settings = LoopSettings(tolerances={"tz": 0.5, "rz": 0.05})
    result = Positioner(camera_model(), settings).run(cell, cell)
    assert result.status == "converged"
    assert abs(cell.delta_p[2]) < 0.5e-3
    assert abs(cell.delta_p[5]) < np.radians(0.05)
    noisy = Cell(starts(0.5, 1)[0] * RANGES, noise=3.0)
    strict = LoopSettings(tolerances={"tz": 1e-4})
    result = Positioner(camera_model(), strict).run(noisy, noisy)
    assert result.status == "limited"
    assert "of tz, 0.0001 mm asked for" in result.message
