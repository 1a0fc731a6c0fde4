"""Robots that have some degrees of freedom alone: a gantry over a textured plane."""

from dataclasses import replace

import numpy as np
import pytest

from planar import PIVOT, RANGES, planar_data_set, planar_images
from planar_cell import SIZE, T_WORLD_REF, Cell
from servoscope.commands.accuracy import has_table
from servoscope.commands.info import describe_model
from servoscope.data.images import PoseImageSet
from servoscope.dofs import mask_of
from servoscope.errors import DataSetError, InvalidInputError, ModelError
from servoscope.keyframe import CameraModel
from servoscope.poses import (
    DISPLAY_FACTORS,
    DOFS,
    displacements_from_poses,
    inverse_transform,
    poses_from_displacements,
)
from servoscope.positioning import (
    Estimate,
    KeyframeModel,
    LoopSettings,
    Positioner,
    PositioningModel,
    train,
)
from servoscope.positioning.calibration import Calibration
from servoscope.rehearsal import Rehearsal
from servoscope.robots.registry import make_robot
from servoscope.scoreboard.cell import robot_in_cell
from servoscope.storage.model_folder import read_model, write_model
from small_keyframe import quick_fits

GANTRY = ("tx", "ty", "rz")
STILL = ~mask_of(GANTRY)
KNOWN = Calibration(camera=CameraModel(1.4, 0.5 / SIZE, 0.5 / SIZE))


class GantryCell(Cell):
    """It comes to rest a little off, on all axes, over a part that may lie otherwise.

    Parameters
    ----------
    delta_p : ndarray of shape (6,)
        Where it starts; it has the dofs of the gantry.
    part : sequence of 6 floats
        How the camera stands to the part where the robot is at the reference, [mm] and [deg].
    """

    def __init__(self, delta_p, part=(0.0,) * 6, seed: int = 0) -> None:
        super().__init__(delta_p * mask_of(GANTRY), noise=1.0)
        self.rng = np.random.default_rng(seed)
        self.part = poses_from_displacements(np.eye(4), np.array(part) / DISPLAY_FACTORS, PIVOT)

    def read(self) -> np.ndarray:
        off = np.append(self.rng.normal(0, 2e-5, 3), self.rng.normal(0, 5e-5, 3))
        D = inverse_transform(T_WORLD_REF) @ self.pose @ poses_from_displacements(np.eye(4), off, 0)
        seen = displacements_from_poses(np.eye(4), (self.part @ D)[None], PIVOT)
        image = planar_images(seen, SIZE, seed=3)[0]
        return (
            np.clip(image + self.rng.normal(0, 1.0, image.shape), 0, 255).round().astype(np.uint8)
        )


def starts(n: int, seed: int, share: float = 0.6) -> np.ndarray:
    return share * np.random.default_rng(seed).uniform(-1, 1, (n, 6)) * RANGES


@pytest.fixture(scope="module")
def data() -> PoseImageSet:
    """Twenty images of the gantry, with noise of the encoders on all axes."""
    cells = [GantryCell(p, seed=k) for k, p in enumerate(starts(20, 0))]
    noise = np.random.default_rng(1).normal(size=(20, 6)) * ([2e-5] * 3 + [5e-5] * 3)
    poses = np.stack([cell.pose for cell in cells]) @ poses_from_displacements(np.eye(4), noise, 0)
    reference = Cell(np.zeros(6)).read()
    return PoseImageSet(
        np.stack([cell.read() for cell in cells]), poses, T_WORLD_REF, reference, pivot=PIVOT
    )


@pytest.fixture(scope="module")
def model(data) -> KeyframeModel:
    with quick_fits():
        return train(data, calibration=KNOWN, n_jobs=1)


@pytest.mark.slow
def test_a_gantry_arrives_and_moves_along_no_axis_that_it_has_not(model):
    for k, start in enumerate(starts(4, 7)):
        cell = GantryCell(start, seed=k)
        result = Positioner(model).run(cell, cell)
        assert result.status == "converged", result.message
        assert np.linalg.norm(cell.delta_p[:2]) < 3e-4
        assert abs(cell.delta_p[5]) < np.radians(0.05)
        moved = [displacements_from_poses(T_WORLD_REF, T[None], PIVOT)[0] for T in cell.poses]
        assert np.abs(np.array(moved)[:, STILL]).max() < 1e-9
        for step in result.steps[:-1]:
            commanded = displacements_from_poses(np.eye(4), step.commanded[None], PIVOT)[0]
            assert np.abs(commanded[STILL]).max() < 1e-12


@pytest.mark.slow
def test_beliefs_and_results_are_of_its_dofs_alone(model, data):
    cell = GantryCell(starts(1, 8)[0])
    result = Positioner(model, LoopSettings(tolerances={"tx": 0.5, "rz": 0.2})).run(cell, cell)
    assert result.status == "converged"
    facts = result.to_dict()
    assert facts["dofs"] == list(GANTRY)
    for name in ("remaining", "std", "predicted_error"):
        assert [value is None for value in facts[name]] == STILL.tolist()
    for name in ("error_shares", "median", "quantile_90"):
        assert tuple(model.accuracy[name]) == GANTRY
    assert max(model.accuracy["error_shares"].values()) < 0.1
    np.testing.assert_array_equal(model.reach > 0, ~STILL)
    assert model.first_guess is not None
    assert np.abs(model.first_guess(data.images[0])[:, 2, 3]).max() < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("part", [(0, 0, 3, 1, 0, 0), (0, 0, -3, 0, -1, 0), (0, 0, 10, 3, -3, 0)])
def test_a_part_that_lies_otherwise_than_the_robot_can_follow_ends_the_loop_honestly(model, part):
    for k, start in enumerate(starts(2, 9)):
        cell = GantryCell(start, part, seed=k)
        result = Positioner(model).run(cell, cell)
        assert result.status == "limited", result.message
        assert "not commanded" in result.message
        assert np.linalg.norm(cell.delta_p[:2]) < 2e-3
        assert abs(cell.delta_p[5]) < np.radians(0.4)


@pytest.mark.slow
def test_a_model_keeps_its_dofs_and_one_of_before_has_all_six(model, data, tmp_path):
    model.save(tmp_path / "model")
    loaded = PositioningModel.load(tmp_path / "model")
    assert loaded.dofs == GANTRY
    for image in data.images[:3]:
        before, after = model.estimate(image), loaded.estimate(image)
        np.testing.assert_array_equal(before.displacement, after.displacement)
        np.testing.assert_array_equal(before.std, after.std)
    header, arrays = read_model(tmp_path / "model")
    reach = list(RANGES)
    old = {name: value for name, value in header.items() if name != "dofs"} | {"reach": reach}
    without = {name: a for name, a in arrays.items() if name != "keyframe/dofs"}
    write_model(tmp_path / "old", old, without)
    assert PositioningModel.load(tmp_path / "old").dofs == DOFS
    for k, wrong in enumerate(({"dofs": ["tz"]}, {"dofs": "tx"}, {"dofs": 3}, {"reach": reach})):
        write_model(tmp_path / str(k), header | wrong, arrays)
        with pytest.raises(ModelError) as info:
            PositioningModel.load(tmp_path / str(k))
        assert "\n" not in str(info.value)


@pytest.mark.slow
def test_what_is_shown_of_a_model_is_of_its_dofs(model, tmp_path):
    model.save(tmp_path / "model")
    facts = describe_model(tmp_path / "model")
    assert facts["dofs"] == list(GANTRY)
    for shown in (facts["ranges"], facts["limit"], facts["accuracy"]["median"]):
        assert tuple(shown) == GANTRY
    assert has_table(facts["accuracy"])


@pytest.mark.slow
def test_a_rehearsal_starts_and_ends_in_the_dofs_of_the_model(model):
    rehearsal = Rehearsal(model, starts=2)
    assert tuple(rehearsal.described_ranges()) == GANTRY
    found = rehearsal.run("range_1.0", n_jobs=1)
    assert found["success"] == 2
    assert all(np.array(start["shares"])[STILL].max() == 0 for start in found["starts"])


@pytest.mark.parametrize("robot", ["free", "arm"])
def test_a_simulated_start_is_one_that_the_robot_can_come_back_from(robot):
    cell = robot_in_cell("textured_plane", 0, robot, "range_1.0", 16, 0, 1, GANTRY)
    reference = make_robot(robot, cell.scene)
    delta_p = displacements_from_poses(reference.pose, cell.pose[None], 0.0)[0]
    assert np.abs(delta_p[STILL]).max() < 1e-3
    assert np.abs(delta_p[5]) > np.radians(1)


@pytest.mark.slow
def test_a_tolerance_of_a_dof_that_is_not_commanded_is_refused(model):
    with pytest.raises(InvalidInputError, match="tx, ty, rz, got tz") as info:
        Positioner(model, LoopSettings(tolerances={"tx": 0.1, "tz": 0.1}))
    assert "\n" not in str(info.value)


@pytest.mark.slow
def test_fewer_dofs_than_are_read_may_be_commanded(model):
    few = replace(model, dofs=("tx", "ty"))
    cell = GantryCell(starts(1, 10)[0], part=(0, 0, 0, 0, 0, 3))
    before = cell.delta_p[5]
    result = Positioner(few).run(cell, cell)
    assert result.status == "limited", result.message
    assert "not commanded" in result.message
    assert result.dofs == ("tx", "ty")
    assert abs(cell.delta_p[5] - before) < 1e-9
    assert np.isnan(result.remaining[2:]).all()


def test_dofs_that_never_move_are_refused_in_one_line():
    still = replace(planar_data_set(20, SIZE), asked_dofs=("tx", "tz"))
    fixed = replace(still, T_world_cam=np.tile(np.eye(4), (20, 1, 1)))
    with pytest.raises(DataSetError, match="tx, tz never move"):
        train(fixed)


class PanTilt:
    """An estimator of two rotations that knows the truth."""

    dofs = ("rx", "ry")
    image_shape, pivot, reach = (SIZE, SIZE), 0.0, RANGES * mask_of(("rx", "ry"))
    reference_image = planar_images(np.zeros((1, 6)), SIZE, seed=3)[0]

    def __init__(self, cell: Cell) -> None:
        self.cell = cell

    def estimate(self, image, previous) -> Estimate:
        D = inverse_transform(T_WORLD_REF) @ self.cell.pose
        delta_p = displacements_from_poses(np.eye(4), D[None], 0.0)[0] * mask_of(self.dofs)
        std = np.where(mask_of(self.dofs), 1e-5, np.nan)
        return Estimate(poses_from_displacements(np.eye(4), delta_p, 0.0), std, 0.1, "oracle")


def test_the_guard_lets_a_pan_tilt_unit_turn_about_both_axes_at_once():
    about_camera = np.radians([0, 0, 0, 15, -15, 0])
    cell = Cell(np.zeros(6))
    cell.poses = [poses_from_displacements(T_WORLD_REF, about_camera, 0.0)]
    result = Positioner(PanTilt(cell)).run(cell, cell)
    assert result.status == "converged", result.message
    assert np.abs(cell.delta_p).max() < 1e-9
