"""The trained model brings the camera back, wherever it sits on the robot."""

import numpy as np
import pytest

from planar import RANGES, planar_images
from planar_cell import SIZE, T_WORLD_REF, Cell
from planar_model import FLANGE_RANGES, T_FLANGE_CAM, FlangeCell, camera_model, flange_model
from servoscope.poses import pose_error
from servoscope.positioning import Positioner
from servoscope.positioning.disturbances import Disturbances

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
    assert np.median([result.moves for result, _ in runs]) <= 6


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
    assert np.median([result.moves for result, _ in runs]) <= 6


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
