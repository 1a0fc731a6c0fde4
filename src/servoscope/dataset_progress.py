"""How far an unfinished data set has come, kept in its folder so that it can be gone on with."""

from __future__ import annotations

import os
import shutil
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import DataSetError
from servoscope.files import write_arrays, write_json
from servoscope.storage.archives import read_arrays
from servoscope.storage.reading import read_json
from servoscope.storage.stacks import PER_CHUNK, create_stack, read_stack, write_stack

Folder = str | PathLike[str]

IMAGES_PER_CHUNK = PER_CHUNK

KEPT_IMAGES = "taken.servoscope"
"""The folder of images that are taken until there are enough, within that of the data set."""


class Progress(NamedTuple):
    """How far an unfinished data set has come.

    Parameters
    ----------
    plan : dict
        What is being made, as plain JSON values.
    n_done : int
        How many images are written.
    n_replaced : int
        How many of their poses could not be reached and were drawn anew.
    """

    plan: dict[str, Any]
    n_done: int
    n_replaced: int = 0


def create_poses(folder: Folder, n_images: int) -> None:
    """Make room for the poses of images that are still to be taken."""
    create_stack(Path(folder) / "poses.zarr", (n_images, 4, 4), "float64")


def write_poses(folder: Folder, start: int, T_world_cam: NDArray[np.float64]) -> None:
    """Keep the poses of the images ``start, start + 1, ...`` until the data set is finished."""
    write_stack(Path(folder) / "poses.zarr", start, T_world_cam)


def read_poses(folder: Folder, n_images: int) -> NDArray[np.float64]:
    """The poses kept by `write_poses`, shape (n_images, 4, 4), [m]."""
    return read_stack(Path(folder) / "poses.zarr", (n_images, 4, 4), "float64")


def keep_image(
    folder: Folder, i: int, image: NDArray[np.uint8], pose: NDArray[np.float64], n_replaced: int
) -> None:
    """Keep image i with its pose, whole or not at all, where it is not known how many will be."""
    kept = Path(folder) / KEPT_IMAGES
    kept.mkdir(exist_ok=True)
    arrays: dict[str, NDArray[Any]] = {"image": image, "pose": pose}
    arrays["n_replaced"] = np.array(n_replaced)
    write_arrays(kept / f"{i:06d}.npz", arrays)


def kept_images(
    folder: Folder,
) -> tuple[NDArray[np.uint8], NDArray[np.float64], NDArray[np.int_]]:
    """Images kept by `keep_image`, their poses, and how many draws each replaced, in order.

    Raises
    ------
    DataSetError
        If one of them is damaged.
    """
    kept: list[dict[str, NDArray[Any]]] = []
    while (path := Path(folder) / KEPT_IMAGES / f"{len(kept):06d}.npz").exists():
        arrays = read_arrays(path, ("image", "pose", "n_replaced"), DataSetError)
        image, pose = arrays["image"], arrays["pose"]
        alike = not kept or image.shape == kept[0]["image"].shape
        if image.dtype != np.uint8 or image.ndim != 2 or pose.shape != (4, 4) or not alike:
            raise DataSetError(f"{path} holds no image with its pose; begin again with --force.")
        kept.append(arrays)
    if not kept:
        return np.empty((0, 0, 0), np.uint8), np.empty((0, 4, 4)), np.empty(0, int)
    images, poses, replaced = (
        np.stack([arrays[name] for arrays in kept]) for name in ("image", "pose", "n_replaced")
    )
    return images, poses, replaced


def write_progress(folder: Folder, progress: Progress) -> None:
    """Note how far the data set has come."""
    write_json(Path(folder) / "acquisition.json", progress._asdict())


def read_progress(folder: Folder) -> Progress | None:
    """How far an unfinished data set has come, or None.

    Raises
    ------
    DataSetError
        If the file that says so is damaged.
    """
    path = Path(folder) / "acquisition.json"
    if not os.path.lexists(path):
        return None
    values = read_json(path, DataSetError)
    plan, counts = values.get("plan"), [values.get("n_done"), values.get("n_replaced", 0)]
    if not isinstance(plan, dict) or any(type(n) is not int or n < 0 for n in counts):
        raise DataSetError(
            f"{path} must hold a plan and the numbers n_done and n_replaced; begin again with "
            "--force, or in another folder."
        )
    return Progress(plan, *counts)


def forget_progress(folder: Folder) -> None:
    """Remove what is kept of an unfinished data set but its images.

    ``acquisition.json`` goes last: without it nothing that is there is kept of one.
    """
    progress = Path(folder) / "acquisition.json"
    if os.path.lexists(progress):
        for part in ("poses.zarr", KEPT_IMAGES):
            shutil.rmtree(Path(folder) / part, ignore_errors=True)
        progress.unlink()
