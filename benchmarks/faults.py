"""Faults put into camera and robot on purpose: how the loop ends, and whether it says so truly.

A simulated cell at 128 x 128 pixels, a model of 930 images, starts at three distances. A run is
falsely converged when it ends `converged` farther than 1 mm or 0.1 deg from the reference.
"""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from benchmarks.tables import Findings
from servoscope.acquisition import AcquisitionConfig, acquire
from servoscope.data.images import PoseImageSet
from servoscope.data.schedule import parse_schedule
from servoscope.poses import inverse_transform, pose_error, rigid_transform
from servoscope.positioning import LoopSettings, Positioner, PositioningModel, train
from servoscope.processes import in_processes, one_blas_thread
from servoscope.scene.scene import T_WORLD_REF
from servoscope.scoreboard.cell import robot_in_cell

SIZE = 128
SCHEDULE = "240@1.6,240@1.0,150@0.4,150@0.12,150@0.04"
PARTS = ("cylinder_head", "textured_plane")
CONDITIONS = ("range_0.4", "range_1.0")
N_STARTS = 12

Image = NDArray[np.uint8]
Array = NDArray[np.float64]


def _same(value: Any) -> Any:
    return value


def _mirrored(displacement: Array) -> Array:
    mirror = np.diag([-1.0, 1.0, 1.0, 1.0])
    return mirror @ displacement @ mirror


@dataclass(frozen=True)
class Fault:
    """What is wrong with a cell.

    Parameters
    ----------
    image : callable
        What becomes of an image.
    motion : callable
        What becomes of a displacement before it is executed; the robot reports the one it was
        sent.
    delay : int
        How many reads old the images are.
    carried : ndarray of shape (4, 4)
        How something else moves the robot while each image is taken, as the robot reports it.
    """

    image: Callable[[Image], Image] = _same
    motion: Callable[[Array], Array] = _same
    delay: int = 0
    carried: Array = field(default_factory=lambda: np.eye(4))


class FaultyCell:
    """Camera and robot of a simulated cell, with a fault.

    Parameters
    ----------
    cell : FreeCamera
    fault : Fault
    """

    def __init__(self, cell: Any, fault: Fault) -> None:
        self.cell, self.fault = cell, fault
        self.reported = cell.pose
        self.path = [cell.true_pose]
        self.buffer = [self._grab() for _ in range(fault.delay)]

    @property
    def pose(self) -> Array:
        return self.reported

    def read(self) -> Image:
        self.buffer.append(self._grab())
        self.reported = self.reported @ self.fault.carried
        self.cell.move(self.fault.carried)
        return self.buffer.pop(0)

    def move(self, displacement: Array) -> Array:
        self.cell.move(self.fault.motion(displacement))
        self.path.append(self.cell.true_pose)
        self.reported = self.reported @ displacement
        return displacement

    def stop(self) -> None:
        """Nothing moves after a move has returned."""

    def _grab(self) -> Image:
        return np.ascontiguousarray(self.fault.image(self.cell.read()))


def _turned(axis: str, degrees: float) -> Callable[[Array], Array]:
    R = Rotation.from_euler(axis, degrees, degrees=True).as_matrix()
    turn = rigid_transform(R, np.zeros(3))
    return lambda D: turn @ D @ turn.T


def _scaled(factor: float) -> Callable[[Array], Array]:
    def scale(D: Array) -> Array:
        turn = factor * Rotation.from_matrix(D[:3, :3]).as_rotvec()
        return rigid_transform(Rotation.from_rotvec(turn).as_matrix(), factor * D[:3, 3])

    return scale


def _brighter(gain: float) -> Callable[[Image], Image]:
    return lambda image: np.clip(gain * image.astype(float), 0, 255).astype(np.uint8)


FAULTS = {
    "none": Fault(),
    "camera late by 1 image": Fault(delay=1),
    "camera late by 2 images": Fault(delay=2),
    "camera late by 5 images": Fault(delay=5),
    "moves inverted": Fault(motion=inverse_transform),
    "moves not executed": Fault(motion=lambda D: np.eye(4)),
    "moves twice as long": Fault(motion=_scaled(2.0)),
    "moves a tenth as long": Fault(motion=_scaled(0.1)),
    "moves mirrored": Fault(motion=_mirrored),
    "frame turned by 90 deg about z": Fault(motion=_turned("z", 90)),
    "frame turned by 180 deg about x": Fault(motion=_turned("x", 180)),
    "image mirrored": Fault(image=lambda image: image[:, ::-1]),
    "image upside down": Fault(image=lambda image: image[::-1, ::-1]),
    "image turned by 90 deg": Fault(image=lambda image: image.T[::-1]),
    "image inverted": Fault(image=lambda image: 255 - image),
    "image 1.3 times as bright": Fault(image=_brighter(1.3)),
    "image 1.6 times as bright": Fault(image=_brighter(1.6)),
    "image 2 times as bright": Fault(image=_brighter(2.0)),
    "image shifted by 3 pixels": Fault(image=lambda image: np.roll(image, 3, axis=1)),
    "robot carried 2 mm at each image": Fault(carried=rigid_transform(np.eye(3), [0.002, 0, 0])),
}


def tables(quick: bool) -> Iterator[Findings]:
    """How runs with each fault end, one table a part."""
    n_starts = 3 if quick else N_STARTS
    for part in PARTS:
        with tempfile.TemporaryDirectory() as folder:
            model = Path(folder) / "model"
            config = AcquisitionConfig(
                part=part, image_size=SIZE, schedule=parse_schedule(SCHEDULE)
            )
            acquire(Path(folder) / "data", config)
            train(PoseImageSet.load(Path(folder) / "data")).save(model)
            calls = [(part, model, name, n_starts) for name in FAULTS]
            rows = list(in_processes(try_fault, calls))
        yield Findings(
            f"Faults on {part}",
            f"{n_starts * len(CONDITIONS)} starts each; falsely: converged more than 1 mm or 0.1 "
            "deg away; farther: ever more than twice as far away as at the start",
            (
                "fault",
                "converged",
                "falsely",
                "inconsistent",
                "other ends",
                "most moves",
                "farther",
            ),
            rows,
        )


def try_fault(part: str, model: Path, name: str, n_starts: int) -> tuple[str, ...]:
    """The row of a fault."""
    estimator = PositioningModel.load(model)
    settings = LoopSettings(read_timeout_s=None, move_timeout_s=None)
    ends: Counter[str] = Counter()
    moves, farther = 0, 0
    with one_blas_thread():
        for condition in CONDITIONS:
            for start in range(n_starts):
                cell = robot_in_cell(part, 0, "free", condition, SIZE, 5, start)
                faulty = FaultyCell(cell, FAULTS[name])
                result = Positioner(estimator, settings).run(faulty, faulty)
                mm, rad = pose_error(T_WORLD_REF, cell.true_pose)
                is_there = mm < 1e-3 and np.degrees(rad) < 0.1
                is_true = is_there or result.status != "converged"
                ends[result.status if is_true else "falsely"] += 1
                moves = max(moves, result.moves)
                distances = pose_error(T_WORLD_REF, np.stack(faulty.path))[0]
                farther += int(distances.max() > 2.05 * distances[0])
    others = {k: n for k, n in ends.items() if k not in ("converged", "falsely", "inconsistent")}
    return (
        name,
        str(ends["converged"]),
        str(ends["falsely"]),
        str(ends["inconsistent"]),
        ", ".join(f"{n} {k}" for k, n in others.items()) or "-",
        str(moves),
        str(farther),
    )
