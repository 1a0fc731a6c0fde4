"""Taking images at random poses around the reference, in blocks that survive an interruption."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope import dataset_folder
from servoscope.dataset import PoseImageSet
from servoscope.dataset_folder import Folder
from servoscope.errors import FolderExistsError, InvalidInputError
from servoscope.poses import poses_from_displacements
from servoscope.processes import in_processes
from servoscope.robots.free_camera import FreeCamera, Repeatability
from servoscope.scene.scene import T_WORLD_REF, Scene

Array = NDArray[np.float64]

_POSES, _CAMERA, _REFERENCE = range(3)
"""What random numbers are drawn for: each has a stream of its own."""


@dataclass(frozen=True)
class AcquisitionConfig:
    """What images to take; the defaults are the paper's.

    Parameters
    ----------
    n_images : int
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
        robot comes to rest. The commanded pose is what is stored.

    Raises
    ------
    InvalidInputError
        If a number is out of its range.
    """

    n_images: int = 1000
    image_size: int = 256
    seed: int = 0
    translation_mm: float = 25.0
    rotation_deg: float = 15.0
    pivot_mm: float = 550.0
    repeatability_mm: float = 0.05
    repeatability_deg: float = 0.01

    def __post_init__(self) -> None:
        self.scene()
        for name, least in (("n_images", 1), ("seed", 0)):
            value = getattr(self, name)
            if not isinstance(value, int) or value < least:
                raise InvalidInputError(
                    f"{name} must be a whole number from {least}, got {value!r}."
                )
        for name, limit in (
            ("translation_mm", 200.0),
            ("rotation_deg", 60.0),
            ("pivot_mm", 5000.0),
            ("repeatability_mm", 10.0),
            ("repeatability_deg", 10.0),
        ):
            value = getattr(self, name)
            if not 0 <= value <= limit:
                raise InvalidInputError(f"{name} must be from 0 to {limit:g}, got {value}.")

    def scene(self) -> Scene:
        """The scene that is looked at."""
        return Scene(image_size=self.image_size)

    def repeatability(self) -> Repeatability:
        """The robot's error, in metres and radians."""
        return Repeatability(1e-3 * self.repeatability_mm, np.radians(self.repeatability_deg))

    def ranges(self) -> Array:
        """Largest displacement of each dof about the pivot, shape (6,), [m] and [rad]."""
        return np.array([1e-3 * self.translation_mm] * 3 + [np.radians(self.rotation_deg)] * 3)

    def poses(self) -> Array:
        """The poses that are commanded, ``T_world_cam``, shape (n_images, 4, 4), [m].

        More images with the same seed begin with the same poses.
        """
        rng = np.random.default_rng([self.seed, _POSES])
        delta_p = rng.uniform(-1.0, 1.0, (self.n_images, 6)) * self.ranges()
        return poses_from_displacements(T_WORLD_REF, delta_p, 1e-3 * self.pivot_mm)


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
    one that is finished is read.

    Parameters
    ----------
    folder : path-like
    config : AcquisitionConfig, optional
    n_jobs : int
        Processes, as joblib counts them; all cores by default. Every number of them gives the
        same images.
    force : bool
        Replace a data set that is there.
    on_progress : callable, optional
        Called with the number of images that are written.

    Returns
    -------
    PoseImageSet

    Raises
    ------
    FolderExistsError
        If the folder holds a data set that was asked for with another config.
    """
    config = AcquisitionConfig() if config is None else config
    plan = {"kind": "simulated cylinder head", **asdict(config)}
    if force:
        dataset_folder.remove(folder)
    start = _begin(folder, plan, config)
    if start is None:
        return PoseImageSet.load(folder)
    blocks = _blocks(start, config.n_images)
    n_jobs = n_jobs if len(blocks) > 1 else 1
    for images in in_processes(_take_block, ((config, block) for block in blocks), n_jobs):
        dataset_folder.write_images(folder, start, images)
        start += len(images)
        dataset_folder.write_progress(folder, plan, start)
        if on_progress is not None:
            on_progress(start)
    (reference_image,) = in_processes(_take_reference, [(config,)], n_jobs)
    _finish(folder, plan, config, reference_image)
    return PoseImageSet.load(folder)


def _begin(folder: Folder, plan: dict[str, Any], config: AcquisitionConfig) -> int | None:
    """The first image that is missing from the folder, or None if none is."""
    progress = dataset_folder.read_progress(folder)
    if progress == (plan, 0):  # it may have stopped before the stack was made
        dataset_folder.remove(folder)
        progress = None
    if progress is not None and progress[0] == plan:
        return progress[1]
    if dataset_folder.is_finished(folder):
        if dataset_folder.read_meta(folder)["source"] == plan:
            return None
    elif progress is not None:
        made = ", ".join(f"{key} {progress[0].get(key)}" for key in ("n_images", "seed"))
        raise FolderExistsError(
            f"{folder} holds an unfinished acquisition of other settings ({made}); repeat them to "
            "finish it, replace it with --force, or name another folder."
        )
    dataset_folder.create(folder, config.n_images, (config.image_size,) * 2, plan)
    return 0


def _finish(
    folder: Folder,
    plan: dict[str, Any],
    config: AcquisitionConfig,
    reference_image: NDArray[np.uint8],
) -> None:
    dataset_folder.finish(
        folder,
        reference_image=reference_image,
        T_world_ref=T_WORLD_REF,
        T_world_cam=config.poses(),
        names=[f"{i:06d}" for i in range(config.n_images)],
        times=None,
        meta={
            "pivot": 1e-3 * config.pivot_mm,
            "pivot_ranges": config.ranges(),
            "split": "random",
            "source": plan,
        },
    )


def _blocks(start: int, stop: int) -> list[range]:
    """The images from `start` on, in blocks that fill the chunks of the stack."""
    step = dataset_folder.IMAGES_PER_CHUNK
    edges = [start, *range((start // step + 1) * step, stop, step), stop]
    return [range(a, b) for a, b in pairwise(edges) if a < b]


def _take_block(config: AcquisitionConfig, block: range) -> NDArray[np.uint8]:
    poses = config.poses()
    images = []
    for i in block:
        rng = np.random.default_rng([config.seed, _CAMERA, i])
        camera = FreeCamera(config.scene(), poses[i], config.repeatability(), rng)
        camera.move_to(poses[i])
        images.append(camera.read())
    return np.stack(images)


def _take_reference(config: AcquisitionConfig) -> NDArray[np.uint8]:
    rng = np.random.default_rng([config.seed, _REFERENCE])
    return FreeCamera(config.scene(), rng=rng).read()
