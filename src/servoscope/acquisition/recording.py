"""Taking images with any robot: every image on disk at once, and a robot that is never lost."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from servoscope.acquisition.plan import Draws, Plan
from servoscope.data import folder as dataset_folder
from servoscope.data.folder import Folder, Progress
from servoscope.data.images import PoseImageSet
from servoscope.data.pixel_noise import mean_image
from servoscope.data.schedule import RECOMMENDED, Ring, Schedule, check_schedule, format_schedule
from servoscope.dofs import check_dofs, mask_of
from servoscope.errors import (
    AcquisitionStoppedError,
    DataSetError,
    FolderExistsError,
    InvalidInputError,
    RobotFaultError,
)
from servoscope.poses import (
    DOFS,
    as_rigid,
    displacements_from_poses,
    inverse_transform,
    pose_error,
)
from servoscope.positioning import arrival, guard
from servoscope.positioning.devices import (
    Interruption,
    RunEnded,
    WatchedCamera,
    WatchedRobot,
    call_within,
)
from servoscope.positioning.interfaces import Camera, Image, Robot
from servoscope.positioning.reference_view import Comparison, ReferenceView
from servoscope.positioning.settings import LoopSettings
from servoscope.positioning.workspace import UNLIMITED, Workspace
from servoscope.wording import one_line

Array = NDArray[np.float64]

_MOST_CLIPPED = 0.25
_BLURRED = 0.4
_RELIT = 0.1
_MOVED, _ALIKE = 2e-3, 0.7
_N_TRIES = 3
_NOTICEABLE = 0.02
_FEW, _MOST_REFUSED = 3, 0.2


@dataclass(frozen=True)
class RecordingConfig:
    """What images a robot is to take.

    Parameters
    ----------
    n_images : int, optional
        Images within 1.6 times the range; 40 by default.
    translation_mm, rotation_deg : float
        The range from which a model is to bring the camera back: along and about each axis, about
        the pivot.
    pivot_mm : float
        How far before the origin of the reported frame, along its z axis, the part is: rotations
        are about there, so that it stays in view.
    dofs : tuple of str
        The degrees of freedom that are displaced.
    seed : int
        Of the poses.
    schedule : sequence of (n_images, factor)
        Rings to take instead, each from `factor` times the range.
    workspace : Workspace, optional
        What the reported frame never leaves.
    max_step_mm, max_step_deg : float
        Longer ways are gone in steps of at most so much.
    n_reference_images : int
        The reference image is the mean of so many; they also show the noise of one.
    check_every : int
        After so many images the reference is looked at again.
    settle_s : float
        How long the view may take to come to rest after a move, [s].
    read_timeout_s, move_timeout_s : float
        How long an image and a move may take, [s].

    Raises
    ------
    InvalidInputError
        If a number is out of its range.
    """

    n_images: int | None = None
    translation_mm: float = 25.0
    rotation_deg: float = 15.0
    pivot_mm: float = 550.0
    dofs: tuple[str, ...] = DOFS
    seed: int = 0
    schedule: Schedule = ()
    workspace: Workspace = UNLIMITED
    max_step_mm: float = 50.0
    max_step_deg: float = 10.0
    n_reference_images: int = 16
    check_every: int = 50
    settle_s: float = 5.0
    read_timeout_s: float = 5.0
    move_timeout_s: float = 60.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "dofs", check_dofs(self.dofs))
        if self.schedule and self.n_images is not None:
            raise InvalidInputError("A schedule says how many images to take; leave n_images out.")
        for name, least in (("seed", 0), ("n_reference_images", 1), ("check_every", 1)):
            value = getattr(self, name)
            if type(value) is not int or value < least:
                raise InvalidInputError(
                    f"{name} must be a whole number from {least}, got {value!r}."
                )
        for name, low, most in (
            ("translation_mm", 0.0, 1e4), ("rotation_deg", 0.0, 180.0), ("pivot_mm", 0.0, 1e5),
            ("max_step_mm", 0.1, 1e4), ("max_step_deg", 0.1, 180.0), ("settle_s", 0.0, 3600.0),
            ("read_timeout_s", 1e-3, 3600.0), ("move_timeout_s", 1e-3, 36000.0),
        ):  # fmt: skip
            if not low <= float(getattr(self, name)) <= most:
                raise InvalidInputError(
                    f"{name} must be from {low:g} to {most:g}, got {getattr(self, name)!r}."
                )
        rings = self.schedule or (Ring(self.n_images or 0, 1.0),) * (self.n_images is not None)
        check_schedule(rings)

    @property
    def rings(self) -> Schedule:
        """What is taken."""
        if self.n_images is not None:
            return (Ring(self.n_images, RECOMMENDED[0].factor),)
        return self.schedule or RECOMMENDED

    @property
    def total(self) -> int:
        """How many images that are."""
        return sum(ring.n_images for ring in self.rings)

    @property
    def ranges(self) -> Array:
        """Largest displacement of each dof at factor 1, (6,), [m] and [rad]; 0 of others."""
        ranges = [1e-3 * self.translation_mm] * 3 + [np.radians(self.rotation_deg)] * 3
        return np.where(mask_of(self.dofs), ranges, 0.0)

    def plan(self, T_world_ref: Array) -> Plan:
        """Where a robot that stands at a pose (4, 4) will go."""
        return Plan.draw(
            Draws(self.rings, self.ranges, self.seed),
            T_world_ref,
            pivot=1e-3 * self.pivot_mm,
            workspace=self.workspace,
            check_every=self.check_every,
            most_m=1e-3 * self.max_step_mm,
            most_rad=float(np.radians(self.max_step_deg)),
        )

    def source(self) -> dict[str, Any]:
        """What decides on the images, as plain JSON values."""
        facts = asdict(self)
        for name in ("n_images", "schedule", "workspace", "settle_s", "read_timeout_s"):
            del facts[name]
        del facts["move_timeout_s"], facts["check_every"]
        return {
            "kind": "taken by a robot",
            **facts,
            "dofs": list(self.dofs),
            "rings": format_schedule(self.rings),
            "workspace": self.workspace.corners(),
        }

    def loop_settings(self) -> LoopSettings:
        """The limits under which the robot is watched."""
        return LoopSettings(read_timeout_s=self.read_timeout_s, move_timeout_s=self.move_timeout_s)


@dataclass(frozen=True, eq=False)
class Shot:
    """An image of an acquisition as it was taken, and what is seen of how good it is.

    Parameters
    ----------
    number : int or None
        Of its draw; None of the reference.
    image : ndarray of shape (height, width), uint8
    T_world : ndarray of shape (4, 4)
        Where the robot reports to stand, [m].
    taken, refused : tuple of int
        Images that are on disk, and those to which the robot would not go, by their numbers.
    sharpness, brightness : float
        As shares of those of the reference image.
    matched, shift : float or None
        Of the reference looked at again: how much of it matches, and by how much of its width it
        is displaced.
    """

    number: int | None
    image: Image
    T_world: Array
    taken: tuple[int, ...]
    refused: tuple[int, ...]
    sharpness: float
    brightness: float
    matched: float | None = None
    shift: float | None = None

    def __str__(self) -> str:
        what = "The reference" if self.number is None else f"Image {self.number}"
        words = (
            f"{what}: {self.sharpness:.0%} as sharp and {self.brightness:.0%} as bright as the "
            "reference image"
        )
        if self.matched is not None and self.shift is not None:
            words += f"; {self.matched:.0%} of it match, displaced by {self.shift:.2%} of its width"
        return f"{words}{', blurred' * self.is_blurred}."

    @property
    def is_blurred(self) -> bool:
        """Whether the focus may not reach there."""
        return self.sharpness < _BLURRED


def acquire_from(
    robot: Robot,
    camera: Camera,
    folder: Folder,
    *,
    force: bool = False,
    confirm: Callable[[Plan], bool] | None = None,
    on_progress: Callable[[int], object] | None = None,
    on_message: Callable[[str], object] | None = None,
    on_shot: Callable[[Shot], object] | None = None,
    **settings: Any,
) -> PoseImageSet:
    """Take images of a part around the pose where the robot stands, and write them to a folder.

    Every image is on disk before the robot moves on. An acquisition that was stopped, for whatever
    reason, goes on when it is called again with the same settings: about the same reference, and
    without the pose at which the robot stopped by itself.

    Parameters
    ----------
    robot : Robot
        At the reference; it has `pose`, ``move_to(pose)`` and ``stop()``. Poses that it is sent to
        are computed from the reference alone, and what it reports is made a rotation again, so
        that nothing adds up.
    camera : Camera
    folder : path-like
    force : bool
        Replace a data set that is there.
    confirm : callable, optional
        Called with the `Plan` before the first move; nothing is moved unless it returns True.
    on_progress : callable, optional
        Called with the number of images that are on disk.
    on_message : callable, optional
        Called with what a person should know while it goes on: blurred images, another light.
    on_shot : callable, optional
        Called with the reference before `confirm`, and with every image that is on disk and every
        look at the reference before the robot moves on; it may wait.
    **settings
        Of `RecordingConfig`.

    Returns
    -------
    PoseImageSet
        In the order of the draws, which is not that of the way. `source` says what of the light
        and the part was seen to change, and which poses the robot refused.

    Raises
    ------
    AcquisitionStoppedError
        If it was stopped: by a fault of the robot or the camera, by a part or a camera that was
        moved, by the user, or since `confirm` did not agree. The robot is back at the reference
        unless it is at fault or was stopped by the user.
    InvalidInputError
        If a setting is out of its range, or the reference image shows nothing.
    FolderExistsError
        If the folder holds another data set.
    FolderInUseError
        If another command is writing there.
    """
    config = RecordingConfig(**settings)
    begun = not dataset_folder.is_finished(folder) and _found(folder) is not None
    with dataset_folder.writing(folder, replace=force and not begun, resumable=True) as place:
        if not _is_there(place, config, force):
            work = _Recording(robot, camera, place, config, on_progress, on_message, on_shot)
            work.run(confirm)
    return PoseImageSet.load(folder)


def preview(robot: Robot, config: RecordingConfig) -> Plan:
    """Where a robot would go from where it stands; it is not moved."""
    return config.plan(WatchedRobot(robot, config.loop_settings()).pose)


def _found(folder: Folder) -> Progress | None:
    try:
        return dataset_folder.read_progress(folder)
    except DataSetError:
        return None


def _is_there(folder: Path, config: RecordingConfig, force: bool) -> bool:
    """Whether the folder holds the whole data set; it is made free for what is not there."""
    source = config.source()
    if dataset_folder.is_finished(folder):
        found = dataset_folder.read_meta(folder)["source"]
        if all(found.get(name) == value for name, value in source.items()):
            dataset_folder.forget_progress(folder)
            return True
    progress = dataset_folder.read_progress(folder)
    if progress is not None and progress.plan == {"source": source}:  # stopped before it began
        dataset_folder.remove(folder)
        progress = None
    if progress is None or progress.plan.get("source") != source:
        if force:
            dataset_folder.remove(folder)
        elif progress is not None:
            raise FolderExistsError(
                f"{folder} holds an unfinished acquisition of other settings; repeat them to "
                "finish it, replace it with --force, or name another folder."
            )
        else:
            dataset_folder.check_free(folder)
    return False


class _Recording:
    """One acquisition, and how far it has come."""

    def __init__(
        self,
        robot: Robot,
        camera: Camera,
        folder: Path,
        config: RecordingConfig,
        on_progress: Callable[[int], object] | None,
        on_message: Callable[[str], object] | None,
        on_shot: Callable[[Shot], object] | None,
    ) -> None:
        self._config, self._folder, self._device = config, folder, camera
        self._robot = WatchedRobot(robot, config.loop_settings())
        self._on_progress = on_progress or (lambda _: None)
        self._say = on_message or (lambda _: None)
        self._on_shot = on_shot or (lambda _: None)
        self._checks: list[dict[str, Any]] = []
        self._last: tuple[Image, Array] | None = None
        self._begun: _Begun | None = None
        self._fault: RunEnded | OSError | None = None  # after which the robot is on its way back

    def run(self, confirm: Callable[[Plan], bool] | None) -> None:
        """Take what is not there yet, and finish the data set."""
        with Interruption() as interruption:
            try:
                begun = self._taken(confirm, interruption)
                interruption.hold()
            except KeyboardInterrupt as error:
                interruption.hold()
                fault = self._fault
                after = "." if fault is None else f" on the way back, after: {_sentence(fault)}"
                raise AcquisitionStoppedError(
                    f"Interrupted{after} {self._robot.stop()} {self._standing()}"
                ) from error
            except AcquisitionStoppedError:  # the robot was stopped
                interruption.hold()
                raise
            except BaseException:
                interruption.hold()
                self._robot.stop()
                raise
            self._robot.stop()
        self._finish(begun)

    def _taken(self, confirm: Callable[[Plan], bool] | None, interruption: Interruption) -> _Begun:
        """What has all images; after a fault the robot goes back to the reference, if it can."""
        try:
            begun = self._prepare(confirm)
            self._take_all(begun, interruption)
        except RunEnded as end:
            interruption.check()  # a driver, or a lock, may have made another error of it
            self._fault = end
            raise AcquisitionStoppedError(
                f"{_sentence(end)} {self._left(end.status)} {self._standing()}"
            ) from end
        except OSError as error:
            interruption.check()
            self._fault = error
            raise AcquisitionStoppedError(
                f"{self._folder} cannot be written ({one_line(error)}); make room. "
                f"{self._left('disk')} {self._standing()}"
            ) from error
        return begun

    def _prepare(self, confirm: Callable[[Plan], bool] | None) -> _Begun:
        """What was begun before, or else the reference as it is seen now."""
        config = self._config
        first = _first_image(self._device)
        ReferenceView(first)  # something is seen
        shape = first.shape[:2]
        self._camera = WatchedCamera(self._device, shape, config.loop_settings())
        progress, at = dataset_folder.read_progress(self._folder), self._robot.pose
        if not config.workspace.holds(at):
            raise RunEnded(
                "out_of_workspace",
                f"The robot stands outside the workspace ({config.workspace}); move it inside.",
            )
        begun = self._begin(at) if progress is None else _read_begun(self._folder, progress)
        self._reference = ReferenceView(begun.reference_image)
        self._plan = config.plan(begun.T_world_ref)
        distance, angle = pose_error(begun.T_world_ref, at)
        if progress is not None:
            self._say(
                f"{len(begun.taken)} of {config.total} images are there; the robot stands "
                f"{1e3 * distance:.0f} mm and {np.degrees(angle):.0f} deg from the reference, and "
                "goes there first."
            )
        self._on_shot(_shot(begun, None, begun.reference_image, begun.T_world_ref))
        if confirm is not None and not confirm(self._plan):
            self._robot.stop()
            raise AcquisitionStoppedError("Nothing was moved: the plan was not confirmed.")
        self._begun = begun
        self._last = first, at
        if progress is None:
            dataset_folder.create(self._folder, config.total, shape, {"source": config.source()})
            dataset_folder.keep_reference(self._folder, begun.reference_image)
            self._note(begun)
        else:
            self._go_to(begun.T_world_ref)
            self._check_reference(begun)
        return begun

    def _begin(self, at: Array) -> _Begun:
        """The reference as it is seen now."""
        images = [self._settled()]
        images += [self._camera.read() for _ in range(self._config.n_reference_images - 1)]
        mean, noise = mean_image(images)
        clipped = float(np.mean((mean == 0) | (mean == 255)))
        if clipped > _MOST_CLIPPED:
            self._say(
                f"{clipped:.0%} of the reference image is black or white; change the exposure if "
                "the part is there."
            )
        return _Begun(at, mean, noise, [], [])

    def _note(self, begun: _Begun) -> None:
        """Keep how far it has come."""
        plan = {
            "source": self._config.source(),
            "T_world_ref": begun.T_world_ref.tolist(),
            "image_noise": begun.noise,
            "refused": begun.refused,
        }
        dataset_folder.write_progress(self._folder, Progress(plan, len(begun.taken)))

    def _take_all(self, begun: _Begun, interruption: Interruption) -> None:
        is_new = False
        for stop in self._plan.stops():
            interruption.check()
            if stop is None and is_new:
                self._go_to(begun.T_world_ref)
                self._check_reference(begun)
                is_new = False
            elif stop is not None and stop not in (*begun.taken, *begun.refused):
                self._take(begun, stop)
                is_new = True
        self._go_to(begun.T_world_ref)

    def _take(self, begun: _Begun, i: int) -> None:
        """Take image i, or leave it out if the robot would not go there and stays where it is."""
        at = self._robot.pose
        try:
            self._go_to(self._plan.poses[i])
        except RunEnded as end:
            if end.status != "robot_fault":
                raise
            begun.refused.append(i)
            self._note(begun)
            left_out = f"{_sentence(end)} Image {i}, to which it was on its way, is left out."
            if not self._may_go_on(begun, end, at):
                raise RunEnded(end.status, left_out) from end
            self._say(left_out)
            return
        image, pose = self._look()
        dataset_folder.keep_image(self._folder, len(begun.taken), image, pose, i)
        begun.taken.append(i)
        self._note(begun)
        shot = _shot(begun, i, image, pose)
        if shot.is_blurred:
            self._say(f"Image {i} is blurred: the focus may not reach there.")
        self._on_progress(len(begun.taken))
        self._on_shot(shot)

    def _look(self) -> tuple[Image, Array]:
        """An image that was taken after the last move, and where.

        A camera that keeps images back first shows the view of before, if the way there was one
        step; one that is frozen, and a robot that does not go where it says, show nothing else.
        """
        image, pose = self._settled(), self._robot.pose
        end = time.monotonic() + self._config.settle_s
        while self._last is not None and self._is_as_before(image, pose, *self._last):
            if time.monotonic() > end:
                raise RunEnded(
                    "camera_fault",
                    f"The image is frozen: the view has not changed in {self._config.settle_s:g} s "
                    "though the robot says that it moved; start the camera again, and see that the "
                    "robot really moves.",
                )
            image = self._settled()
        self._last = image, pose
        return image, pose

    def _is_as_before(self, image: Image, T: Array, before: Image, T_before: Array) -> bool:
        """Whether a view has not changed that should have: not by tilts about the part alone."""
        pivot = self._plan.pivot
        moved = np.abs(displacements_from_poses(T_before, T[None], pivot)[0])
        if np.linalg.norm(moved[:3]) / max(pivot, 1e-3) + moved[5] < _NOTICEABLE:
            return False
        return np.array_equal(before, image) or not _has_changed(before, image)

    def _may_go_on(self, begun: _Begun, end: RunEnded, at: Array) -> bool:
        """Whether the robot said that it cannot go there, did not move, and does so seldom."""
        if not isinstance(end.__cause__, RobotFaultError):
            return False
        if len(begun.refused) > max(_FEW, _MOST_REFUSED * self._config.total):
            return False
        self._robot.is_lost = (
            guard.standing_fault(at, self._robot.pose, self._config.loop_settings()) is not None
        )
        return not self._robot.is_lost

    def _go_to(self, T_world: Array) -> None:
        """Go there in steps, none of which leaves the workspace."""
        workspace, at = self._config.workspace, self._robot.pose
        for pose in self._plan.way(at, T_world):
            if workspace.holds(pose):
                self._robot.move(inverse_transform(at) @ pose, at)
                at = self._robot.pose
            if not workspace.holds(at) or not workspace.holds(pose):
                raise RunEnded(
                    "out_of_workspace", f"The robot is leaving its workspace ({workspace})."
                )

    def _settled(self) -> Image:
        """An image from a view that has come to rest, neither black nor white."""
        before, end = self._camera.read(), time.monotonic() + self._config.settle_s
        n_faults = 0
        while True:
            image = self._camera.read()
            fault = self._begun and guard.exposure_fault(image, self._begun.reference_image)
            n_faults += bool(fault)
            if fault and n_faults == _N_TRIES:
                raise RunEnded("camera_fault", fault)
            if not fault and not _has_changed(before, image):
                return image
            if not fault and time.monotonic() > end:
                raise RunEnded(
                    "camera_fault",
                    f"The view has not come to rest within {self._config.settle_s:g} s after a "
                    "move; see that nothing moves in it, or allow it more time.",
                )
            before = image

    def _check_reference(self, begun: _Begun) -> None:
        """Look at the reference again, and end if it is not what it was.

        What was taken since it was last found to be as it was is taken again.
        """
        (image, pose), n_done = self._look(), len(begun.taken)
        gain = _gain(image, begun.reference_image)
        seen = self._reference.compare(image)
        before = self._checks[-1]["n_images"] if self._checks else 0
        where = f"between image {before} and image {n_done}"
        if (seen.shift > _MOVED and arrival.is_displaced(seen)) or seen.matched < _ALIKE:
            dataset_folder.drop_kept(self._folder, before)
            del begun.taken[before:]
            self._note(begun)
            raise RunEnded(
                "inconsistent",
                f"The view of the reference has changed {where}: {seen.matched:.0%} of it match, "
                f"displaced by {seen.shift:.2%} of its width. The part or the camera was moved: "
                "put it back, or begin again with --force.",
            )
        if abs(gain - 1) > _RELIT:
            self._say(f"The light has changed by {gain - 1:+.0%} {where}.")
        self._checks.append(
            {"n_images": n_done, "matched": seen.matched, "shift": seen.shift, "gain": gain}
        )
        self._on_shot(_shot(begun, None, image, pose, seen))

    def _left(self, status: str) -> str:
        """Where the robot is left: at the reference, if it can be sent there."""
        begun, reason = self._begun, ""
        if begun is None:
            self._robot.stop()
            return "Nothing was moved."
        if status not in ("robot_fault", "out_of_workspace") and not self._robot.is_lost:
            try:
                self._go_to(begun.T_world_ref)
                self._robot.stop()
                return "The robot is back at the reference."
            except RunEnded as end:
                reason = f"On the way back: {_sentence(end)} "
        stopped = self._robot.stop()
        try:
            distance, angle = pose_error(begun.T_world_ref, self._robot.pose)
        except RunEnded:
            return f"{reason}{stopped}"
        return (
            f"{reason}{stopped} It is {1e3 * distance:.0f} mm and {np.degrees(angle):.0f} deg from "
            "the reference."
        )

    def _standing(self) -> str:
        n_done = len(self._begun.taken) if self._begun else 0
        return (
            f"{n_done} of {self._config.total} images are on disk; the same command goes on from "
            "there."
        )

    def _finish(self, begun: _Begun) -> None:
        """Write the data set of what was kept, in the order of the draws."""
        config = self._config
        images, poses, numbers = dataset_folder.kept_images(self._folder)
        order = np.argsort(numbers, kind="stable")
        noise = {} if begun.noise is None else {"image_noise": round(begun.noise, 4)}
        dataset_folder.finish_kept(
            self._folder,
            images[order],
            reference_image=begun.reference_image,
            T_world_ref=begun.T_world_ref,
            T_world_cam=poses[order],
            names=[f"{number:06d}" for number in numbers[order]],
            times=None,
            meta={
                "pivot": self._plan.pivot,
                "pivot_ranges": self._ranges(),
                "split": "random",
                **({"dofs": list(config.dofs)} if config.dofs != DOFS else {}),
                "source": {
                    **config.source(),
                    **noise,
                    "n_images": len(images),
                    "refused": begun.refused,
                    "reference_checks": self._checks,
                },
            },
        )

    def _ranges(self) -> Array:
        """The range that was drawn from, or what a workspace left of it, (6,)."""
        asked = max(ring.factor for ring in self._config.rings) * self._config.ranges
        if not self._plan.n_outside:
            return asked
        return np.minimum(asked, np.abs(self._plan.displacements).max(axis=0))


class _Begun(NamedTuple):
    """What is kept of an acquisition: of the images, the numbers of their draws."""

    T_world_ref: Array
    reference_image: Image
    noise: float | None
    refused: list[int]
    taken: list[int]


def _shot(
    begun: _Begun, number: int | None, image: Image, T_world: Array, seen: Comparison | None = None
) -> Shot:
    """How an image is seen to be, beside the reference."""
    reference = begun.reference_image
    return Shot(
        number,
        image,
        T_world,
        tuple(begun.taken),
        tuple(begun.refused),
        _sharpness(image) / max(_sharpness(reference), 1e-9),
        _gain(image, reference),
        *(() if seen is None else (seen.matched, seen.shift)),
    )


def _read_begun(folder: Path, progress: Progress) -> _Begun:
    """What an earlier run has kept.

    Raises
    ------
    DataSetError
        If it is damaged.
    """
    names = ("T_world_ref", "image_noise", "refused")
    pose, noise, refused = (progress.plan.get(name) for name in names)
    try:
        T_world_ref = as_rigid(np.asarray(pose, dtype=float), "T_world_ref")
        numbers = [int(i) for i in refused or ()]
        noise = None if noise is None else float(noise)
    except (TypeError, ValueError) as error:
        raise DataSetError(
            f"{folder} does not say where its acquisition began; begin again with --force."
        ) from error
    _, _, taken = dataset_folder.kept_images(folder)
    reference = dataset_folder.kept_reference(folder)
    return _Begun(T_world_ref, reference, noise, numbers, taken.tolist())


def _first_image(camera: Camera) -> Image:
    """An image of a camera of unknown size.

    Raises
    ------
    RunEnded
        If there is none, or it is not grey.
    """
    try:
        image = call_within(LoopSettings().first_read_timeout_s, camera.read)
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        raise RunEnded("camera_fault", f"The camera failed: {one_line(error)}") from error
    if fault := guard.image_format_fault(image, np.shape(image)[:2]):
        raise RunEnded("camera_fault", fault)
    return image


def _has_changed(before: Image, image: Image) -> bool:
    """Whether two images from one pose are displaced, or show different views."""
    try:
        compared = ReferenceView(before).compare(image)
    except InvalidInputError:  # nothing is seen before
        return True
    return arrival.is_displaced(compared) or compared.matched < _ALIKE


def _sentence(end: BaseException) -> str:
    """Why it ended, with a full stop: drivers say what they like."""
    text = str(end)
    return text if text.endswith((".", "!", "?")) else f"{text}."


def _sharpness(image: Image) -> float:
    """Of the finest details, as a share of the contrast."""
    fine = cv2.Laplacian(image.astype(np.float32), cv2.CV_32F)
    return float(fine.std() / max(float(image.std()), 1.0))


def _gain(image: Image, reference: Image) -> float:
    """How bright an image is, as a share of the reference."""
    return float(image.mean() / max(float(reference.mean()), 1e-9))
