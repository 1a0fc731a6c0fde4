"""Taking images at random poses around the reference, in blocks that survive an interruption."""

from __future__ import annotations

from collections.abc import Callable
from itertools import chain, islice, pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from servoscope.acquisition_config import AcquisitionConfig as AcquisitionConfig
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
from servoscope.errors import DataSetError, FolderExistsError, RobotFaultError
from servoscope.poses import poses_from_displacements
from servoscope.processes import in_processes
from servoscope.robots.registry import make_robot

Array = NDArray[np.float64]
Images = NDArray[np.uint8]

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
    ((reference_image, T_world_ref),) = in_processes(take_reference, [(config,)], n_jobs)
    dataset_folder.finish(
        folder,
        reference_image=reference_image,
        T_world_ref=T_world_ref,
        T_world_cam=read_poses(folder, config.total()),
        names=[f"{i:06d}" for i in range(config.total())],
        times=None,
        meta={
            **config.meta(T_world_ref),
            "source": {**progress.plan, "n_replaced": progress.n_replaced},
        },
    )


def _begin(folder: Path, config: AcquisitionConfig, force: bool) -> Progress | None:
    """What the folder has of the acquisition already, or None if it has all."""
    plan = config.plan()
    if dataset_folder.is_finished(folder):
        source = dataset_folder.read_meta(folder)["source"]
        if source == {**plan, "n_replaced": source.get("n_replaced")}:
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
    draws = islice(chain([first], config.replacements(i)), MOST_DRAWS)
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


def take_reference(config: AcquisitionConfig) -> tuple[Images, Array]:
    """The mean of some images at the reference, and the pose that the robot reports there."""
    robot = make_robot(config.robot, config.scene(), config.repeatability(), config.camera_rng())
    images = [robot.read() for _ in range(config.plan()["n_reference_images"])]
    return np.rint(np.mean(images, axis=0)).astype(np.uint8), robot.pose
