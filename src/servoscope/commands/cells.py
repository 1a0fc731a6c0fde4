"""Where the loop runs and how, as options: those of all commands that run it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from tyro.conf import OmitArgPrefixes, arg

from servoscope.errors import InvalidInputError

if TYPE_CHECKING:
    from servoscope.positioning import LoopSettings, PositioningModel
    from servoscope.robots.recorded import RecordedRobot
    from servoscope.robots.registry import SimulatedRobot

_ANYTHING = "range_1.0"
_RECORDED = "recorded:"


@dataclass(frozen=True)
class CellOptions:
    """The robot that is moved, and where it starts.

    Args:
        robot: The simulated robot that took the images of training (free, arm), which is the
            default; recorded:FOLDER, which goes to the nearest pose of a data set folder and shows
            the image taken there; your own, such as ur:192.0.2.7 or module:Class.
        camera: What takes the images, of a robot of your own: opencv:0, folder:PATH, module:Class
            and others; by default the robot itself.
        start: Number of the start that is drawn, or number or name of the recorded image to begin
            at; otherwise the first start of the seed.
        condition: How the cell differs from the one of training: gain_0.8, light_moved, covered_10,
            noise_10 and others; a name that is none lists them all.
        seed: Seed of the start and of the noise.
    """

    robot: Annotated[str | None, arg(metavar="SPEC")] = None
    camera: Annotated[str | None, arg(metavar="SPEC")] = None
    start: Annotated[str | None, arg(metavar="N")] = None
    condition: Annotated[str, arg(metavar="NAME")] = _ANYTHING
    seed: int = 0

    @property
    def is_own(self) -> bool:
        """Whether the robot is the user's own, neither simulated nor recorded."""
        from servoscope.robots.devices import ROBOT_KINDS, forms
        from servoscope.robots.registry import ROBOTS

        if self.robot is None or self.robot in ROBOTS:
            return False
        kind, _, rest = self.robot.partition(":")
        if not (kind and rest):
            raise InvalidInputError(
                f"--robot must be {', '.join(ROBOTS)}, {forms(ROBOT_KINDS)}, got {self.robot!r}."
            )
        return f"{kind}:" != _RECORDED

    def check(self) -> None:
        """Refuse what does not go together, before anything is opened.

        Raises
        ------
        InvalidInputError
            If the condition is none, or is of another kind of robot, as a camera or a start may be.
        """
        from servoscope.scoreboard.cell import CONDITIONS

        if self.condition not in CONDITIONS:
            raise InvalidInputError(
                f"--condition must be one of {', '.join(CONDITIONS)}, got {self.condition!r}."
            )
        if not self.is_own and self.camera is not None:
            raise InvalidInputError("--camera is of robots of your own; leave it out.")
        if self.is_own and (self.start is not None or self.condition != _ANYTHING):
            raise InvalidInputError(
                "A robot of your own starts where it stands; leave --start and --condition out."
            )
        if self._is_recorded and self.condition != _ANYTHING:
            raise InvalidInputError(
                "--condition is of simulated cells; leave it out with recorded images."
            )

    @property
    def _is_recorded(self) -> bool:
        return self.robot is not None and self.robot.startswith(_RECORDED)

    @contextmanager
    def opened(self, model: PositioningModel, settings: LoopSettings) -> Iterator[Cell]:
        """A robot of the user's own where it stands, or a recorded or simulated one at a start.

        Raises
        ------
        ServoscopeError
            If it cannot be opened, or is none of the model's.
        """
        from servoscope.robots.devices import closing, open_both
        from servoscope.scene.scene import T_WORLD_REF

        self.check()
        if self.robot is not None and self.is_own:
            own, eye = open_both(self.robot, self.camera)
            with closing(own, eye):
                yield Cell(own, eye, settings)
        elif self.robot is not None and self._is_recorded:
            recorded, T_ref = self._recorded(model, Path(self.robot.removeprefix(_RECORDED)))
            settings = settings.for_poses_apart(*recorded.spacing())
            yield Cell(recorded, recorded, settings, T_ref)
        else:
            cell = self._simulated(model)
            yield Cell(cell, cell, settings, T_WORLD_REF, _mount_of_training(model))

    def number(self, wanted: str = "a number from 0") -> int:
        """The whole number that ``--start`` is, 0 by default; `wanted` says what it is of."""
        start = "0" if self.start is None else self.start
        if not (start.isascii() and start.isdigit() and len(start) < 10):
            raise InvalidInputError(f"--start must be {wanted}, got {start!r}.")
        return int(start)

    def _recorded(self, model: PositioningModel, folder: Path) -> tuple[RecordedRobot, Any]:
        """A robot that lives in a recording of the model's reference, and the reference's pose."""
        import numpy as np

        from servoscope.data.images import PoseImageSet
        from servoscope.dofs import mask_of
        from servoscope.positioning.interfaces import dofs_of
        from servoscope.robots.recorded import RecordedRobot

        data = PoseImageSet.load(folder)
        if not np.array_equal(data.reference_image, model.reference_image):
            raise InvalidInputError(
                f"The reference image of {folder} is not the one that the model was trained on; "
                "import the recording with the same reference frame and image width."
            )
        if self.start is None:
            is_within = np.abs(data.delta_p()) <= model.reach
            within = np.flatnonzero(is_within[:, mask_of(dofs_of(model))].all(axis=1))
            if not within.size:
                raise InvalidInputError(
                    f"No image of {folder} was taken within the range that the model was trained "
                    "on; name one with --start, or record nearer to the reference."
                )
            frame = int(np.random.default_rng(self.seed).choice(within))
        elif self.start in data.names:
            frame = list(data.names).index(self.start)
        else:
            frame = self.number(f"the number or the name of an image of {folder}")
        return RecordedRobot(data, frame), data.T_world_ref

    def _simulated(self, model: PositioningModel) -> SimulatedRobot:
        """The robot and the part of training, at a start and under a condition."""
        from servoscope.poses import DOFS
        from servoscope.positioning.interfaces import dofs_of
        from servoscope.scoreboard.cell import PIVOT, robot_in_cell

        source, dofs = model.trained_on, dofs_of(model)
        if not {"part", "variant", "robot"} <= source.keys():
            raise InvalidInputError(
                "The model was not trained on simulated images, so that there is no simulated "
                "robot for it; give --robot recorded:FOLDER with the images, or see "
                "docs/positioning.md on how to run it on a robot of your own."
            )
        if self.robot not in (None, source["robot"]):
            raise InvalidInputError(
                f"The model was trained with --robot {source['robot']}, whose poses it reports; "
                f"leave --robot out, or train one on images acquired with --robot {self.robot}."
            )
        height, _ = model.image_shape
        pivot = PIVOT if dofs == DOFS else 1e-3 * float(source.get("pivot_mm", 1e3 * PIVOT))
        return robot_in_cell(
            source["part"], source["variant"], source["robot"], self.condition, height, self.seed,
            self.number(), dofs, pivot,
        )  # fmt: skip


class Cell(NamedTuple):
    """What the loop runs in.

    Parameters
    ----------
    robot : Robot
        If `T_ref` is known it has the true pose of the camera as ``true_pose``.
    camera : Camera
    settings : LoopSettings
    T_ref : ndarray of shape (4, 4), optional
        True pose of the camera at the reference, if it is known, [m].
    T_reported_cam : ndarray of shape (4, 4), optional
        Where the camera is in the frame that the robot reports, if it is not the camera's, [m].
    """

    robot: Any
    camera: Any
    settings: LoopSettings
    T_ref: Any = None
    T_reported_cam: Any = None

    def true_displacement(self) -> Any:
        """Of the frame that the robot reports, from the reference, (4, 4), [m]."""
        from servoscope.poses import inverse_transform

        T_cam = inverse_transform(self.T_ref) @ self.robot.true_pose
        mount = self.T_reported_cam
        return T_cam if mount is None else mount @ T_cam @ inverse_transform(mount)


def _mount_of_training(model: PositioningModel) -> Any:
    """Where the camera is in the frame that the simulated robot of training reports."""
    from servoscope.robots.registry import make_robot
    from servoscope.scoreboard.cell import mount_of, scene_of_training

    source = model.trained_on
    scene = scene_of_training(source["part"], model.image_shape[0], source["variant"])
    return mount_of(make_robot(source["robot"], scene))


@dataclass(frozen=True)
class LoopOptions:
    """When the loop ends, and the limits that it keeps to.

    Args:
        max_moves: Moves after which it gives up.
        tolerance_mm: Distance from the reference to get under; by default as near as the noise and
            the robot allow.
        tolerance_deg: Angle to get under.
        tolerance: Tolerances of single dofs about the pivot, such as tz=0.1mm,rz=0.02deg; t and r
            stand for all three of a kind.
        repeatability_mm: How far from where it is sent the robot comes to rest, if that is known.
        repeatability_deg: The same for its rotation.
        max_step_mm: Longer steps are cut to this; by default the farthest that the model was made
            for.
        max_step_deg: The same for their rotation.
        workspace_margin: The poses stay in a box around the start, so many times the range that the
            model was made for.
        workspace: A box in mm of the robot's coordinates that the reported frame never leaves, such
            as x=300:700,z=150:600; by default that in which the images were taken.
        execution_mm: A move may end so far from where it was sent, or a fifth of it if that is
            more.
        execution_deg: The same for its rotation.
        least_similarity: Least similarity of an image to what is expected, 0 to 1; by default what
            the model states.
        final_images: Images that are averaged where the camera seems to have arrived.
        read_timeout_s: How long an image or a pose may take.
        first_read_timeout_s: How long the first image may take.
        move_timeout_s: How long a move may take.
    """

    max_moves: int = 12
    tolerance_mm: float | None = None
    tolerance_deg: float | None = None
    tolerance: Annotated[str, arg(metavar="DOF=VALUE,...")] = ""
    repeatability_mm: float = 0.0
    repeatability_deg: float = 0.0
    max_step_mm: float | None = None
    max_step_deg: float | None = None
    workspace_margin: float = 1.6
    workspace: str = ""
    execution_mm: float = 0.5
    execution_deg: float = 0.1
    least_similarity: float | None = None
    final_images: int = 8
    read_timeout_s: float = 5.0
    first_read_timeout_s: float = 30.0
    move_timeout_s: float = 60.0

    def settings(self, model: PositioningModel) -> LoopSettings:
        """What they make of the loop of a model.

        Raises
        ------
        InvalidInputError
            If one is out of its range, or a tolerance is of a dof that the model does not command.
        """
        from servoscope.dofs import parse_tolerances
        from servoscope.positioning import LoopSettings
        from servoscope.positioning.interfaces import dofs_of
        from servoscope.positioning.workspace import Workspace

        numbers = dict(vars(self))
        tolerance, workspace = numbers.pop("tolerance"), numbers.pop("workspace")
        return LoopSettings(
            **numbers,
            tolerances=parse_tolerances(tolerance, dofs_of(model)),
            robot_workspace=Workspace.parse(workspace) if workspace else None,
        )


InCell = OmitArgPrefixes[CellOptions]
Loop = OmitArgPrefixes[LoopOptions]
