"""Faults between the camera and the robot are noticed after one move, and named."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from planar import PIVOT, RANGES
from planar_cell import Cell, Oracle
from servoscope.poses import inverse_transform, poses_from_displacements, rigid_transform
from servoscope.positioning import Estimate, LoopSettings, Positioner
from servoscope.positioning.consistency import innovation

STARTS = [0.5 * RANGES * signs for signs in ([1, -1, 1, -1, 1, 1], [0.2, 0.9, -0.4, 0.3, -1, 0.6])]
SMALL = 0.06 * RANGES * np.array([1, 1, -1, 1, 1, -1])


class Sighted(Oracle):
    """Estimates from the image that was read, not from where the camera is meanwhile."""

    def __init__(self, cell: Cell, camera: "Delayed", std: float = 1e-3) -> None:
        super().__init__(cell, std=std)
        self.camera = camera

    def estimate(self, image, previous):
        seen = poses_from_displacements(np.eye(4), self.camera.delta_p, PIVOT)
        return Estimate(seen, self.std, 0.1, "oracle")


class Delayed:
    """A camera whose images are as many reads old as its buffer is long."""

    def __init__(self, cell: Cell, delay: int, noise: float = 1.0) -> None:
        self.cell, self.noise, self.rng = cell, noise, np.random.default_rng(0)
        self.buffer = [self._grab() for _ in range(delay)]

    def _grab(self):
        image = self.cell.read() + self.rng.normal(0, self.noise, (48, 48))
        return np.clip(image, 0, 255).round().astype(np.uint8), self.cell.delta_p

    def read(self):
        self.buffer.append(self._grab())
        image, self.delta_p = self.buffer.pop(0)
        return image


@pytest.mark.parametrize("start", [*STARTS, SMALL])
def test_a_camera_that_is_one_image_late_is_named_and_still_arrives(start) -> None:
    cell = Cell(start)
    camera = Delayed(cell, 1)
    result = Positioner(Sighted(cell, camera)).run(cell, camera)
    assert result.status == "converged"
    assert "gave images late" in result.message
    assert np.abs(cell.delta_p / RANGES).max() < 5e-3


@pytest.mark.parametrize("delay", [2, 3, 5])
@pytest.mark.parametrize("start", [*STARTS, SMALL])
def test_a_camera_that_is_later_still_ends_the_run_after_one_move(start, delay: int) -> None:
    cell = Cell(start)
    camera = Delayed(cell, delay)
    result = Positioner(Sighted(cell, camera)).run(cell, camera)
    assert (result.status, result.moves) == ("inconsistent", 1)
    assert "images late" in result.message


@pytest.mark.parametrize("delay", [0, 1, 2])
def test_no_delay_makes_it_claim_to_have_arrived_where_it_has_not(delay: int) -> None:
    for seed in range(12):
        rng = np.random.default_rng(seed)
        cell = Cell(rng.choice([0.01, 0.03, 0.1, 0.5]) * rng.uniform(-1, 1, 6) * RANGES)
        camera = Delayed(cell, delay)
        result = Positioner(Sighted(cell, camera)).run(cell, camera)
        assert result.status != "converged" or np.abs(cell.delta_p / RANGES).max() < 0.02


class Wrong(Cell):
    """A robot that executes other moves than it reports."""

    def __init__(self, delta_p, change) -> None:
        super().__init__(delta_p, noise=1.0)
        self.reported, self.change = self.poses[-1], change

    @property
    def pose(self):
        return self.reported

    @property
    def delta_p(self):
        return Cell.delta_p.fget(_At(self.poses[-1]))

    def move(self, displacement):
        self.poses.append(self.poses[-1] @ self.change(displacement))
        self.reported = self.reported @ displacement
        return displacement


class _At:
    def __init__(self, pose) -> None:
        self.pose = pose


def _seen_from(turn: np.ndarray):
    return lambda D: turn @ D @ turn.T


def _turn(axis: str, degrees: float) -> np.ndarray:
    return rigid_transform(
        Rotation.from_euler(axis, degrees, degrees=True).as_matrix(), np.zeros(3)
    )


def _scaled(factor: float):
    def scale(D):
        turn = factor * Rotation.from_matrix(D[:3, :3]).as_rotvec()
        return rigid_transform(Rotation.from_rotvec(turn).as_matrix(), factor * D[:3, 3])

    return scale


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        (inverse_transform, "wrong sign"),
        (_seen_from(np.diag([-1.0, 1, 1, 1])), "mirror"),
        (_seen_from(np.diag([1.0, -1, 1, 1])), "mirror"),
        (_seen_from(_turn("z", 180)), "flipped or turned"),
        (_seen_from(_turn("z", 90)), "flipped or turned"),
        (_seen_from(_turn("x", 120)), "frame or the scale"),
        (_scaled(2.0), "another length"),
        (_scaled(-2.0), "another length"),
        (_scaled(0.1), "late, or the robot did not move"),
        (lambda D: np.eye(4), "late, or the robot did not move"),
    ],
)
@pytest.mark.parametrize("start", STARTS)
def test_a_robot_that_moves_otherwise_than_it_reports_ends_the_run_after_one_move(
    change, cause: str, start
) -> None:
    cell = Wrong(start, change)
    result = Positioner(Oracle(cell, std=1e-3)).run(cell, cell)
    assert (result.status, result.moves) == ("inconsistent", 1)
    assert cause in result.message
    assert "widen" not in result.message


@pytest.mark.parametrize("start", STARTS)
def test_without_believed_deviations_faults_are_named_all_the_same(start) -> None:
    cell = Wrong(start, inverse_transform)
    result = Positioner(Oracle(cell)).run(cell, cell)
    assert (result.status, result.moves) == ("inconsistent", 1)


@pytest.mark.parametrize("degrees", [0, 10, 20])
def test_a_slightly_crooked_frame_is_no_contradiction(degrees: float) -> None:
    cell = Wrong(STARTS[0], _seen_from(_turn("z", degrees)))
    result = Positioner(Oracle(cell, std=1e-3)).run(cell, cell)
    assert result.status == "converged"


def test_one_bad_look_is_looked_at_again() -> None:
    class Once(Oracle):
        n = 0

        def estimate(self, image, previous):
            self.n += 1
            good = super().estimate(image, previous)
            away = poses_from_displacements(np.eye(4), 0.9 * RANGES, PIVOT)
            return replace(good, displacement=away) if self.n == 2 else good

    cell = Cell(STARTS[0])
    result = Positioner(Once(cell, std=1e-3)).run(cell, cell)
    assert (result.status, result.moves) == ("converged", 1)


def test_a_view_that_is_blocked_after_a_move_is_not_taken_for_a_robot_that_moves_wrongly() -> None:
    class Blocked(Oracle):
        def estimate(self, image, previous):
            good = super().estimate(image, previous)
            if previous is None:
                return good
            elsewhere = poses_from_displacements(np.eye(4), RANGES * [1, 1, 1, -1, 0, 1], PIVOT)
            return replace(good, displacement=elsewhere, novelty=2.0)

    class Screened(Cell):
        def read(self):
            image = super().read()
            return image if len(self.poses) == 1 else np.tile(image[:, :12], (1, 4))

    cell = Screened(STARTS[0])
    result = Positioner(Blocked(cell, std=1e-3)).run(cell, cell)
    assert (result.status, result.moves) == ("abstained", 1)


def test_the_innovation_is_zero_where_the_view_follows_the_move() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        before, moved = poses_from_displacements(
            np.eye(4), rng.uniform(-1, 1, (2, 6)) * RANGES, 0.5
        )
        first, second = (Estimate(D, 1e-3 * RANGES, 0.1, "x") for D in (before, before @ moved))
        found = innovation(first, moved, second, pivot=PIVOT, reach=RANGES)
        assert found.share == pytest.approx(0, abs=1e-9)
        assert found.along == pytest.approx(1)
        assert not found.contradicts(0.75)


def test_noise_as_large_as_the_move_contradicts_nothing() -> None:
    limits, rng = LoopSettings(), np.random.default_rng(1)
    for _ in range(200):
        std = 0.02 * RANGES
        before, after = rng.normal(0, 1, (2, 6)) * std
        moved = poses_from_displacements(np.eye(4), -before, PIVOT)
        estimates = [
            Estimate(poses_from_displacements(np.eye(4), p, PIVOT), std, 0.1, "x")
            for p in (before, after)
        ]
        found = innovation(estimates[0], moved, estimates[1], pivot=PIVOT, reach=RANGES)
        assert not found.contradicts(limits.largest_innovation)
