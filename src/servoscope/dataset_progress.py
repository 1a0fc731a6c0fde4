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
from servoscope.files import write_json
from servoscope.storage.reading import read_json
from servoscope.storage.stacks import PER_CHUNK, create_stack, read_stack, write_stack

Folder = str | PathLike[str]

IMAGES_PER_CHUNK = PER_CHUNK


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
    """Remove what is kept of an unfinished data set but its images."""
    shutil.rmtree(Path(folder) / "poses.zarr", ignore_errors=True)
    (Path(folder) / "acquisition.json").unlink(missing_ok=True)
