"""Taking images of the simulated part at random poses: what is asked for, and what is made."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from itertools import chain, islice, pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.acquisition.plan import Draws
from servoscope.data import folder as dataset_folder
from servoscope.data.folder import (
    IMAGES_PER_CHUNK,
    Folder,
    Progress,
    create_poses,
    forget_progress,
    read_poses,
    read_progress,
    write_poses,
    write_progress,
)
from servoscope.data.images import PoseImageSet
from servoscope.data.pixel_noise import mean_image
from servoscope.data.schedule import Ring, Schedule, check_schedule, format_schedule
from servoscope.dofs import check_dofs, mask_of
from servoscope.errors import DataSetError, FolderExistsError, InvalidInputError, RobotFaultError
from servoscope.poses import DOFS, inverse_transform, poses_from_displacements
from servoscope.processes import in_processes
from servoscope.robots.free_camera import Repeatability
from servoscope.robots.registry import check_robot, make_robot
from servoscope.scene.scene import T_WORLD_REF, Scene, make_part

Array = NDArray[np.float64]

MOST_MM, MOST_DEG = 200.0, 60.0
"""Largest displacements along and about an axis."""

_CAMERA, _REFERENCE = 1, 2
"""What random numbers are drawn for beside those of `Draws`: each has streams of its own."""


@dataclass(frozen=True)
class AcquisitionConfig:
    """What images to take; the defaults are the paper's.

    Parameters
    ----------
    n_images : int, optional
        1000 by default; a schedule has its own.
    image_size : int
        Height and width, 16 to 2048, [px].
    seed : int
        Seed of the poses, the robot's errors and the noise.
    translation_mm, rotation_deg : float
        Displacements are drawn evenly from -this to this along and about each axis.
    pivot_mm : float
        Distance from the camera of the point that rotations are about.
    repeatability_mm, repeatability_deg : float
        Standard deviations, along and about each axis, of how far from the commanded pose the
        robot comes to rest. The pose that the robot reports is what is stored.
    schedule : sequence of (n_images, factor)
        Rings, taken one after the other; each draws from `factor` times the range, up to 4.
        Without any, `n_images` are drawn from the range itself.
    part : {"cylinder_head", "textured_plane"}
    variant : int
        Another number, from 0, gives another part of the kind.
    robot : {"free", "arm"}
        What carries the camera: nothing, or a simulated arm, which reports the poses of its flange.
    n_reference_images : int, optional
        How many images the reference image is the mean of: by default 1, as in the paper, and 16
        with a schedule.
    dofs : tuple of str
        The degrees of freedom that are displaced; the robot moves in no others but for its error.

    Raises
    ------
    InvalidInputError
        If a number is out of its range, a name is unknown, or `n_images` and `schedule` are both
        given.

    Examples
    --------
    >>> config = AcquisitionConfig(schedule=[(1000, 1.0), (400, 0.03)])
    >>> config.poses().shape
    (1400, 4, 4)
    """

    n_images: int | None = None
    image_size: int = 256
    seed: int = 0
    translation_mm: float = 25.0
    rotation_deg: float = 15.0
    pivot_mm: float = 550.0
    repeatability_mm: float = 0.05
    repeatability_deg: float = 0.01
    schedule: Schedule = ()
    part: str = "cylinder_head"
    variant: int = 0
    robot: str = "free"
    n_reference_images: int | None = None
    dofs: tuple[str, ...] = DOFS

    def __post_init__(self) -> None:
        object.__setattr__(self, "dofs", check_dofs(self.dofs))
        object.__setattr__(self, "schedule", check_schedule(self.schedule))
        if self.schedule and self.n_images is not None:
            raise InvalidInputError(
                f"A schedule says how many images to take; leave n_images out, got {self.n_images}."
            )
        for name, least in (
            ("n_images", 1),
            ("seed", 0),
            ("variant", 0),
            ("n_reference_images", 1),
        ):
            value = getattr(self, name)
            if value is None and name.startswith("n_"):
                continue
            if not isinstance(value, int) or value < least:
                raise InvalidInputError(
                    f"{name} must be a whole number from {least}, got {value!r}."
                )
        factor = max(ring.factor for ring in self.rings())
        for name, limit, share in (
            ("translation_mm", MOST_MM, factor),
            ("rotation_deg", MOST_DEG, factor),
            ("pivot_mm", 5000.0, 1.0),
            ("repeatability_mm", 10.0, 1.0),
            ("repeatability_deg", 10.0, 1.0),
        ):
            value = getattr(self, name)
            if not 0 <= share * value <= limit:
                times = f" over the largest factor, {share:g}" if share > 1 else ""
                raise InvalidInputError(f"{name} must be from 0 to {limit:g}{times}, got {value}.")
        check_robot(self.robot)
        self.scene()

    def rings(self) -> Schedule:
        """The rings that are taken; one where no schedule is given."""
        return self.schedule or (Ring(1000 if self.n_images is None else self.n_images, 1.0),)

    @property
    def is_subset(self) -> bool:
        """Whether not all degrees of freedom are displaced."""
        return self.dofs != DOFS

    def meta(self, T_world_ref: Array) -> dict[str, Any]:
        """What ``meta.json`` says of such a data set beside its source."""
        meta = {"pivot": self.pivot(T_world_ref), "pivot_ranges": self.pivot_ranges()}
        return meta | {"split": "random"} | ({"dofs": list(self.dofs)} if self.is_subset else {})

    def total(self) -> int:
        """How many images are taken."""
        return sum(ring.n_images for ring in self.rings())

    def plan(self) -> dict[str, Any]:
        """What is taken, as plain JSON values; equal for configs that give the same images."""
        kind = f"simulated {self.part.replace('_', ' ')}"
        settings = asdict(self)
        del settings["schedule"], settings["dofs"]
        if self.is_subset:
            settings["dofs"] = list(self.dofs)
        n_reference_images = self.n_reference_images or (16 if self.schedule else 1)
        numbers = {"n_images": self.total(), "n_reference_images": n_reference_images}
        return {"kind": kind, **settings, **numbers, "rings": format_schedule(self.rings())}

    def scene(self) -> Scene:
        """The scene that is looked at."""
        return Scene(part=make_part(self.part, self.variant), image_size=self.image_size)

    def repeatability(self) -> Repeatability:
        """The robot's error, in metres and radians."""
        return Repeatability(1e-3 * self.repeatability_mm, np.radians(self.repeatability_deg))

    def ranges(self) -> Array:
        """Largest displacement of each dof at factor 1, shape (6,), [m] and [rad]; 0 of others."""
        ranges = [1e-3 * self.translation_mm] * 3 + [np.radians(self.rotation_deg)] * 3
        return np.where(mask_of(self.dofs), ranges, 0.0)

    def pivot_ranges(self) -> Array:
        """Largest displacement of each dof in any ring, shape (6,), [m] and [rad]."""
        return max(ring.factor for ring in self.rings()) * self.ranges()

    def reference(self) -> Array:
        """Pose that the robot reports when the camera is at the reference, (4, 4), [m]."""
        return make_robot(self.robot, self.scene()).pose

    def pivot(self, T_world_ref: Array) -> float:
        """Distance of the pivot from the origin of the frame that the robot reports, [m].

        Rotations are about a point on the z axis of that frame, as far along it as the point
        `pivot_mm` before the camera, so that the part stays in view whatever carries the camera.
        """
        T_reported_cam = inverse_transform(T_world_ref) @ T_WORLD_REF
        return float((T_reported_cam @ [0.0, 0.0, 1e-3 * self.pivot_mm, 1.0])[2])

    def draws(self) -> Draws:
        """What displacements are drawn."""
        return Draws(self.rings(), self.ranges(), self.seed)

    def displacements(self) -> Array:
        """The displacements that are drawn first, about the pivot, (n_images, 6), [m] and [rad]."""
        return self.draws().displacements()

    def camera_rng(self, i: int | None = None) -> np.random.Generator:
        """What draws the robot's errors and the noise of image `i`, or of the reference image."""
        if i is None:
            return self.draws().stream(_REFERENCE, 0)
        return self.draws().stream_of_image(_CAMERA, i)

    def poses(self) -> Array:
        """The poses that are commanded first, shape (n_images, 4, 4), [m]."""
        T_world_ref = self.reference()
        return poses_from_displacements(T_world_ref, self.displacements(), self.pivot(T_world_ref))


Images = NDArray[np.uint8]

_FOUND = {"n_replaced", "image_noise"}
"""What the source of a data set says beside what was asked for."""

MOST_DRAWS = 100
"""How many poses are tried for one image before the ranges are said to be too large."""


def acquire(
    folder: Folder,
    config: AcquisitionConfig | None = None,
    *,
    n_jobs: int = -1,
    force: bool = False,
    on_progress: Callable[[int], object] | None = None,
) -> PoseImageSet:
    """Take images of the simulated part and write them to a data set folder.

    An acquisition that was interrupted goes on where it stopped, and ends with the same images;
    one that is finished is read. What is replaced stays until the new images are all there.

    Parameters
    ----------
    folder : path-like
    config : AcquisitionConfig, optional
    n_jobs : int
        Processes, as joblib counts them; all cores by default. Every number of them gives the
        same images.
    force : bool
        Replace a data set that is there. Interrupted, it goes on like any other when it is
        repeated, `force` included.
    on_progress : callable, optional
        Called with the number of images that are written.

    Returns
    -------
    PoseImageSet
        Its poses are those that the robot reported. Where it could not go, another displacement of
        the same ring was drawn; ``source["n_replaced"]`` counts them.

    Raises
    ------
    FolderExistsError
        If the folder holds a data set that was asked for with another config.
    FolderInUseError
        If another command is writing there.
    RobotFaultError
        If the robot reaches none of the poses that are drawn for an image.
    """
    config = AcquisitionConfig() if config is None else config
    replace = force and not _is_begun(folder, config)
    with dataset_folder.writing(folder, replace=replace, resumable=True) as place:
        _take_all(place, config, n_jobs, force, on_progress)
    return PoseImageSet.load(folder)


def _is_begun(folder: Folder, config: AcquisitionConfig) -> bool:
    """Whether the folder holds an unfinished acquisition of this config, and no whole data set."""
    if dataset_folder.is_finished(folder):
        return False
    try:
        progress = read_progress(folder)
    except DataSetError:
        return False
    return progress is not None and progress.plan == config.plan()


def _take_all(
    folder: Path,
    config: AcquisitionConfig,
    n_jobs: int,
    force: bool,
    on_progress: Callable[[int], object] | None,
) -> None:
    """Take what is not there yet of an acquisition; with `force`, in place of any other one."""
    progress = _begin(folder, config, force)
    if progress is None:
        return
    blocks = _blocks(progress.n_done, config.total())
    n_jobs = n_jobs if len(blocks) > 1 else 1
    for taken in in_processes(_take_block, ((config, block) for block in blocks), n_jobs):
        progress = _write(folder, progress, *taken)
        if on_progress is not None:
            on_progress(progress.n_done)
    ((reference_image, T_world_ref, noise),) = in_processes(take_reference, [(config,)], n_jobs)
    dataset_folder.finish(
        folder,
        reference_image=reference_image,
        T_world_ref=T_world_ref,
        T_world_cam=read_poses(folder, config.total()),
        names=[f"{i:06d}" for i in range(config.total())],
        times=None,
        meta={
            **config.meta(T_world_ref),
            "source": {**progress.plan, "n_replaced": progress.n_replaced, **noise},
        },
    )


def _begin(folder: Path, config: AcquisitionConfig, force: bool) -> Progress | None:
    """What the folder has of the acquisition already, or None if it has all."""
    plan = config.plan()
    if dataset_folder.is_finished(folder):
        source = dataset_folder.read_meta(folder)["source"]
        if {name: source[name] for name in source.keys() - _FOUND} == plan:
            forget_progress(folder)  # it may have stopped just before
            return None
    progress = read_progress(folder)
    if progress == Progress(plan, 0):  # it may have stopped before the stack was made
        dataset_folder.remove(folder)
        progress = None
    if progress is not None and progress.plan == plan:
        if progress.n_done > config.total():
            raise DataSetError(
                f"{folder} counts {progress.n_done} images where {config.total()} are wanted; "
                "begin again with --force."
            )
        return progress
    if force:
        dataset_folder.remove(folder)
    elif progress is not None and not dataset_folder.is_finished(folder):
        made = ", ".join(f"{key} {progress.plan.get(key)}" for key in ("n_images", "seed"))
        raise FolderExistsError(
            f"{folder} holds an unfinished acquisition of other settings ({made}); repeat them to "
            "finish it, replace it with --force, or name another folder."
        )
    config.reference()  # a robot that cannot be made shall leave no folder
    dataset_folder.create(folder, config.total(), (config.image_size,) * 2, plan)
    create_poses(folder, config.total())
    return Progress(plan, 0)


def _write(
    folder: Folder, progress: Progress, images: Images, poses: Array, n_replaced: int
) -> Progress:
    """The progress once a block of images is written."""
    dataset_folder.write_images(folder, progress.n_done, images)
    write_poses(folder, progress.n_done, poses)
    progress = Progress(
        progress.plan, progress.n_done + len(images), progress.n_replaced + n_replaced
    )
    write_progress(folder, progress)
    return progress


def _blocks(start: int, stop: int) -> list[range]:
    """The images from `start` on, in blocks that fill the chunks of the stack."""
    step = IMAGES_PER_CHUNK
    edges = [start, *range((start // step + 1) * step, stop, step), stop]
    return [range(a, b) for a, b in pairwise(edges) if a < b]


def _take_block(config: AcquisitionConfig, block: range) -> tuple[Images, Array, int]:
    """Images, the poses that the robot reported, and how many draws were replaced."""
    T_world_ref, displacements = config.reference(), config.displacements()
    taken = [take_image(config, T_world_ref, i, displacements[i]) for i in block]
    images, poses, n_replaced = zip(*taken, strict=True)
    return np.stack(images), np.stack(poses), sum(n_replaced)


def take_image(
    config: AcquisitionConfig, T_world_ref: Array, i: int, first: Array
) -> tuple[Images, Array, int]:
    """Image `i`, where it was taken, and how many draws could not be reached.

    The robot starts at its reference for every one, so that no image depends on another.
    """
    pivot = config.pivot(T_world_ref)
    draws = islice(chain([first], config.draws().replacements(i)), MOST_DRAWS)
    for n_replaced, delta_p in enumerate(draws):
        rng = config.camera_rng(i)
        robot = make_robot(config.robot, config.scene(), config.repeatability(), rng)
        try:
            robot.move_to(poses_from_displacements(T_world_ref, delta_p, pivot))
        except RobotFaultError as error:
            fault = error
            continue
        return robot.read(), robot.pose, n_replaced
    raise RobotFaultError(
        f"The robot reaches none of {MOST_DRAWS} poses drawn for image {i} ({fault}); take "
        "smaller ranges or factors."
    )


def take_reference(config: AcquisitionConfig) -> tuple[Images, Array, dict[str, float]]:
    """The mean of some images at the reference, where they were taken, and what noise they have.

    The last is what the source of a data set says of it: nothing where one image was taken.
    """
    robot = make_robot(config.robot, config.scene(), config.repeatability(), config.camera_rng())
    images = [robot.read() for _ in range(config.plan()["n_reference_images"])]
    mean, noise = mean_image(images)
    return mean, robot.pose, {} if noise is None else {"image_noise": round(noise, 4)}
