"""The loop arrives with a fair estimator, and is stopped with a wrong one."""

import time
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from planar import PIVOT, RANGES, planar_images
from planar_cell import SIZE, T_WORLD_REF, Cell, Oracle
from servoscope.errors import InvalidInputError
from servoscope.poses import (
    displacement_ranges,
    displacements_from_poses,
    inverse_transform,
    pose_error,
    poses_from_displacements,
)
from servoscope.positioning.interfaces import Estimate
from servoscope.positioning.look_and_move import Positioner
from servoscope.positioning.settings import LoopSettings
from servoscope.positioning.workspace import Workspace
from servoscope.robots.free_camera import FreeCamera, Repeatability
from servoscope.scene.scene import T_WORLD_REF as SCENE_REF
from servoscope.scene.scene import Scene
from servoscope.scene.textured_plane import TexturedPlane

START = 0.5 * RANGES * [1, -1, 1, -1, 1, 1]

unit_cube = arrays(float, 6, elements=st.floats(-1, 1, width=32))


@settings(max_examples=40, deadline=None)
@given(start=unit_cube, gain=arrays(float, 6, elements=st.floats(0.7, 1.3)))
def test_with_estimates_within_30_percent_it_arrives_without_leaving_the_box(start, gain) -> None:
    cell = Cell(start * RANGES)
    result = Positioner(Oracle(cell, lambda p: gain * p)).run(cell, cell)
    distance, angle = pose_error(T_WORLD_REF, cell.pose)
    assert result.status == "converged", result.message
    assert distance < 0.05e-3 / 0.7
    assert angle < np.radians(0.005) / 0.7
    offsets = displacements_from_poses(cell.poses[0], np.array(cell.poses), 0.0)
    assert (np.abs(offsets) <= 1.35 * displacement_ranges(RANGES, 0.55, "camera") + 1e-9).all()


@settings(max_examples=40, deadline=None)
@given(start=unit_cube.filter(lambda start: np.abs(start).max() > 0.3), gain=st.floats(0.6, 1))
def test_with_the_wrong_sign_it_is_stopped_after_one_move(start, gain) -> None:
    cell = Cell(start * RANGES)
    limits = LoopSettings(max_moves=40)
    result = Positioner(Oracle(cell, lambda p: -gain * p, std=1e-4), limits).run(cell, cell)
    assert (result.status, result.moves) in (("inconsistent", 1), ("out_of_workspace", 0))
    offsets = displacements_from_poses(cell.poses[0], np.array(cell.poses), 0.0)
    assert (np.abs(offsets) <= 1.3 * displacement_ranges(RANGES, 0.55, "camera") + 1e-9).all()


def test_unjudged_moves_that_lead_away_are_stopped_by_the_image_error_and_undone() -> None:
    cell = Cell(0.4 * START)
    limits = LoopSettings(largest_innovation=None)
    result = Positioner(Oracle(cell, lambda p: -0.5 * p), limits).run(cell, cell)
    assert result.status == "diverged"
    best = min(result.steps, key=lambda step: step.image_error)
    np.testing.assert_allclose(cell.pose, best.pose, atol=1e-9)
    assert result.steps[result.returned_to] is best


def test_a_perfect_estimator_needs_one_move() -> None:
    cell = Cell(START)
    result = Positioner(Oracle(cell, std=1e-3)).run(cell, cell)
    assert (result.status, result.moves, len(result.steps)) == ("converged", 1, 2)
    np.testing.assert_allclose(result.remaining, 0, atol=1e-12)
    np.testing.assert_allclose(result.predicted_error, 1e-3 * RANGES)


def test_a_dry_run_tells_the_move_and_makes_none() -> None:
    cell = Cell(START)
    result = Positioner(Oracle(cell)).run(cell, cell, dry_run=True)
    assert (result.moves, len(cell.poses)) == (0, 1)
    assert result.status == "dry_run"
    assert result.message.startswith("Dry run: the robot would move ")
    np.testing.assert_allclose(cell.pose @ result.steps[0].commanded, T_WORLD_REF, atol=1e-12)
    np.testing.assert_allclose(result.remaining, START, atol=1e-12)


def test_a_dry_run_at_the_reference_has_converged() -> None:
    cell = Cell(np.zeros(6))
    assert Positioner(Oracle(cell)).run(cell, cell, dry_run=True).status == "converged"


def test_the_robot_does_not_leave_its_workspace() -> None:
    cell = Cell(START)
    x = 1e3 * cell.pose[0, 3]
    beside = Workspace.parse(f"x={x + 1}:{x + 500}")
    for box, what in ((Workspace.parse(f"x={x - 1}:{x + 1}"), "would be sent"), (beside, "stands")):
        result = Positioner(Oracle(cell), LoopSettings(robot_workspace=box)).run(cell, cell)
        assert (result.status, result.moves) == ("out_of_workspace", 0)
        assert f"{what} outside its workspace (x" in result.message
    known = Oracle(cell)  # of images that were taken in a box
    known.trained_on = {"workspace": beside.corners()}
    assert Positioner(known).run(cell, cell).status == "out_of_workspace"
    wide = LoopSettings(robot_workspace=Workspace.parse(f"x={x - 500}:{x + 500}"))
    assert Positioner(known, wide).run(cell, cell).status == "converged"


def test_long_steps_are_cut_and_still_arrive() -> None:
    cell = Cell(START)
    limits = LoopSettings(max_step_mm=20, max_step_deg=4, max_moves=20)
    result = Positioner(Oracle(cell), limits).run(cell, cell)
    assert result.status == "converged"
    steps = [pose_error(a, b) for a, b in zip(cell.poses, cell.poses[1:], strict=False)]
    assert max(distance for distance, _ in steps) <= 20e-3 * (1 + 1e-6)
    assert max(angle for _, angle in steps) <= np.radians(4) * (1 + 1e-6)
    assert result.moves > 3


def test_a_step_of_the_estimators_own_is_made_instead_of_the_whole_way() -> None:
    class Damped(Estimate):
        step = None

    class Slow(Oracle):
        def estimate(self, image, previous):
            whole, half = super().estimate(image, None), Oracle(self.cell, lambda p: p / 2)
            estimate = Damped(whole.displacement, whole.std, whole.novelty, whole.stage)
            object.__setattr__(estimate, "step", half.estimate(image, None).displacement)
            return estimate

    cell = Cell(START)
    result = Positioner(Slow(cell), LoopSettings(max_moves=20)).run(cell, cell)
    assert result.status == "converged"
    assert 8 <= result.moves <= 12
    np.testing.assert_allclose(result.remaining, cell.delta_p, atol=1e-12)


@pytest.mark.parametrize("std", [0.01, 0.05])
def test_noise_in_the_estimates_ends_the_run_as_near_as_it_allows(std: float) -> None:
    moves = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        cell = Cell(START)
        oracle = Oracle(cell, lambda p, rng=rng: p + std * RANGES * rng.normal(size=6), std=std)
        result = Positioner(oracle).run(cell, cell)
        assert result.status == "converged"
        assert "noise" in result.message
        assert np.abs(cell.delta_p / (std * RANGES)).max() < 4.5
        moves.append(result.moves)
    assert np.median(moves) <= 4


def test_an_insignificant_coarse_estimate_does_not_end_the_run() -> None:
    class TwoStages(Oracle):
        def estimate(self, image, previous):
            fine = Oracle(self.cell, std=1e-4).estimate(image, None)
            if np.abs(self.cell.delta_p / RANGES).max() < 0.1:
                return fine
            return Estimate(fine.displacement, RANGES, np.nan, "coarse")

    cell = Cell(START)
    result = Positioner(TwoStages(cell)).run(cell, cell)
    assert result.status == "converged"
    assert np.abs(cell.delta_p / RANGES).max() < 1e-6


def test_too_few_moves_end_where_the_image_was_best() -> None:
    cell = Cell(START)
    result = Positioner(Oracle(cell, lambda p: 0.3 * p), LoopSettings(max_moves=3)).run(cell, cell)
    assert (result.status, result.moves) == ("max_moves", 3)
    np.testing.assert_allclose(result.remaining, 0.3 * cell.delta_p, atol=1e-9)
    assert result.returned_to is None

    cell = Cell(START)
    limits = LoopSettings(max_moves=1, largest_innovation=None)
    worse = Positioner(Oracle(cell, lambda p: -p / 2), limits).run(cell, cell)
    assert (worse.status, worse.returned_to, worse.moves) == ("max_moves", 0, 2)
    np.testing.assert_allclose(cell.delta_p, START, atol=1e-12)


def test_the_estimator_is_told_its_own_estimate_before() -> None:
    seen = []

    class Listening(Oracle):
        def estimate(self, image, previous):
            seen.append(previous)
            return super().estimate(image, previous)

    cell = Cell(START)
    result = Positioner(Listening(cell, lambda p: 0.8 * p)).run(cell, cell)
    assert seen == [None, *(step.estimate for step in result.steps[:-1])]


def test_each_look_is_told_before_the_robot_moves() -> None:
    cell, told = Cell(START), []

    def on_step(step, image):
        told.append((step.executed, len(cell.poses), image.shape))

    result = Positioner(Oracle(cell)).run(cell, cell, on_step=on_step)
    assert told == [(None, 1, (48, 48)), (None, 2, (48, 48))]
    assert result.steps[0].executed is not None


def test_a_reference_image_without_anything_in_it_is_refused() -> None:
    oracle = Oracle(Cell(START))
    oracle.reference_image = np.full((48, 48), 128, np.uint8)
    with pytest.raises(InvalidInputError, match="reference image must show something"):
        Positioner(oracle)
    oracle.reference_image = np.zeros((40, 48), np.uint8)
    with pytest.raises(InvalidInputError, match="48 x 48 pixels, but the camera gave 48 x 40"):
        Positioner(oracle)


def test_a_robot_that_scatters_is_stopped_as_near_as_its_repeatability_allows() -> None:
    scene = Scene(part=TexturedPlane(), image_size=32)
    start = poses_from_displacements(SCENE_REF, START, 0.55)
    repeatability = Repeatability(1e-4, np.radians(0.01))
    camera = FreeCamera(scene, start, repeatability, np.random.default_rng(0))

    class OfScene(Oracle):
        image_shape = (32, 32)
        reference_image = FreeCamera(scene).read()

        def estimate(self, image, previous):
            displacement = inverse_transform(SCENE_REF) @ camera.true_pose
            return Estimate(displacement, 1e-5 * RANGES, 0.3, "oracle")

    limits = LoopSettings(repeatability_mm=0.1, repeatability_deg=0.01)
    result = Positioner(OfScene(None), limits).run(camera, camera)
    assert result.status == "converged"
    assert "noise" in result.message
    assert result.moves <= 4
    distance, angle = pose_error(camera.true_pose, SCENE_REF)
    assert distance < 0.5e-3
    assert angle < np.radians(0.05)


class Noisy(Oracle):
    """An oracle that errs by the noise of the image, and knows by how much."""

    SHARE, NOISE = 2e-3, 2.0

    def estimate(self, image, previous):
        clean = super().estimate(image, previous)
        seen = planar_images(self.cell.delta_p[None], SIZE, seed=3)[0]
        noise = (image.astype(float) - seen)[16:-16].ravel() / self.NOISE
        parts = np.array([noise[k::6].mean() * np.sqrt(noise[k::6].size) for k in range(6)])
        off = poses_from_displacements(np.eye(4), self.SHARE * RANGES * parts, self.pivot)
        std = self.SHARE * RANGES * noise.std()
        return replace(clean, displacement=clean.displacement @ off, std=std)


def _ends(n_images: int, **tolerance) -> tuple[np.ndarray, list]:
    cells = [Cell(START * share, Noisy.NOISE) for share in np.linspace(0.2, 1, 8)]
    limits = LoopSettings(final_images=n_images, **tolerance)
    for seed, cell in enumerate(cells):
        cell.rng = np.random.default_rng(seed)
    runs = [Positioner(Noisy(cell), limits).run(cell, cell) for cell in cells]
    ends = np.array([pose_error(T_WORLD_REF, cell.pose)[0] for cell in cells])
    return ends, runs


def test_several_images_at_the_end_bring_it_nearer_than_the_noise_of_one() -> None:
    (one, _), (several, runs) = _ends(2), _ends(12)
    assert {run.status for run in runs} == {"converged"}
    assert np.sqrt(np.mean(several**2)) < 0.6 * np.sqrt(np.mean(one**2))


def test_a_tolerance_that_is_met_costs_no_move_more() -> None:
    _, runs = _ends(12, tolerance_mm=5, tolerance_deg=1)
    assert {run.status for run in runs} == {"converged"}
    assert max(run.moves for run in runs) <= 1


def test_images_that_differ_at_the_end_are_not_averaged() -> None:
    class Shaken(Cell):
        def read(self):
            self.pose = self.pose @ poses_from_displacements(np.eye(4), 0.1 * START[None], 0.55)[0]
            return super().read()

    cell = Shaken(0 * START)
    result = Positioner(Oracle(cell, std=0.2 * RANGES)).run(cell, cell)
    assert result.status != "converged"


def test_a_mean_of_the_last_images_that_is_not_recognised_ends_the_run_unmoved() -> None:
    class CoveredOnce(Noisy):
        n_answers = 0

        def estimate(self, image, previous):
            self.n_answers += 1
            found = super().estimate(image, previous)
            return replace(found, novelty=2.0) if self.n_answers == 2 else found

    cell = Cell(0 * START, Noisy.NOISE)
    limits = LoopSettings(tolerance_mm=5, tolerance_deg=1)
    result = Positioner(CoveredOnce(cell), limits).run(cell, cell)
    assert (result.status, result.moves) == ("abstained", 0)


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
    for p in 0.5 * np.random.default_rng(7).uniform(-1, 1, (8, 6)):
        cell = Scattering(p * RANGES)
        oracle = Oracle(cell, std=1e-5)
        settings = LoopSettings(tolerance_mm=0.05, tolerance_deg=0.005)
        ends.append(Positioner(oracle, settings).run(cell, cell))
    assert {end.status for end in ends} <= {"limited", "converged"}
    assert any("As near as the robot allows" in end.message for end in ends)
    free = [replace(settings, tolerance_mm=None, tolerance_deg=None)] * 2
    for settings, p in zip(
        free, 0.5 * np.random.default_rng(7).uniform(-1, 1, (2, 6)), strict=True
    ):
        cell = Scattering(p * RANGES)
        assert Positioner(Oracle(cell, std=1e-5), settings).run(cell, cell).status == "converged"


class Wavering:
    """Believes something else of every image."""

    image_shape, reference_image = Oracle.image_shape, Oracle.reference_image
    pivot, reach = PIVOT, RANGES

    def __init__(self, seed: int, off: float, std: float, is_finest: float) -> None:
        self.rng, self.off, self.std, self.is_finest = (
            np.random.default_rng(seed), off, std, is_finest
        )  # fmt: skip

    def estimate(self, image: np.ndarray, previous: Estimate | None) -> Estimate:
        believed = self.off * self.rng.uniform(-1, 1, 6) * RANGES
        displacement = poses_from_displacements(np.eye(4), believed, PIVOT)
        is_finest = bool(self.rng.random() < self.is_finest)
        return Estimate(displacement, self.std * RANGES, 0.5, "wavering", is_finest)


MOST_IMAGES = 13 * (6 + 8)
"""Looks before each move and after the last, and images that are averaged."""

share = st.sampled_from([0.0, 1e-4, 1e-3, 1e-2, 0.05, 0.1, 0.3])


@example(start=0.0, seed=6, off=0.01, std=0.0, is_finest=0.5, tolerance_mm=None, noise=0.0)
@settings(max_examples=60, deadline=None)
@given(
    start=share,
    seed=st.integers(0, 9),
    off=share,
    std=share,
    is_finest=st.sampled_from([0.5, 1.0]),
    tolerance_mm=st.sampled_from([None, 0.1, 5.0]),
    noise=st.sampled_from([0.0, 2.0]),
)
def test_whatever_an_estimator_believes_a_run_ends(
    start, seed, off, std, is_finest, tolerance_mm, noise
) -> None:
    cell, n_read = Cell(start * RANGES, noise), 0
    read = cell.read

    def counted() -> np.ndarray:
        nonlocal n_read
        n_read += 1
        assert n_read <= MOST_IMAGES
        return read()

    cell.read = counted
    estimator = Wavering(seed, off, std, is_finest)
    loop = LoopSettings(tolerance_mm=tolerance_mm)
    result = Positioner(estimator, loop).run(cell, cell)
    assert n_read <= MOST_IMAGES, result.message
    assert result.moves <= 2 * loop.max_moves


def test_the_time_of_a_decision_is_without_that_of_the_camera() -> None:
    class Slow(Cell):
        def read(self):
            time.sleep(0.03)
            return super().read()

    cell = Slow(START)
    result = Positioner(Oracle(cell, std=1e-3)).run(cell, cell)
    assert result.status == "converged"
    assert max(step.seconds for step in result.steps[1:]) < 4 * 0.03


@dataclass(frozen=True, eq=False, kw_only=True)
class Cautious(Estimate):
    """Asks for a part of the way."""

    step: np.ndarray


def test_an_estimator_that_goes_a_part_of_the_way_at_each_move_goes_on_to_the_end() -> None:
    """Small moves are no scatter of the robot, though the camera comes little nearer by each."""

    class Tenth(Oracle):
        def estimate(self, image, previous):
            whole = super().estimate(image, previous)
            part = poses_from_displacements(np.eye(4), 0.12 * self.cell.delta_p, PIVOT)
            return Cautious(**vars(whole), step=part)

    cell = Cell(0.1 * START)
    result = Positioner(Tenth(cell), LoopSettings(max_moves=100, growth=2.0)).run(cell, cell)
    assert result.status == "converged", result.message
    assert 1e3 * pose_error(T_WORLD_REF, cell.pose)[0] <= 0.05
