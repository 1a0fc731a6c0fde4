"""How far an unfinished data set has come, kept in its folder so that it can be gone on with."""

from __future__ import annotations

import shutil
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import DataSetError
from servoscope.files import read_json, write_json

Folder = str | PathLike[str]

IMAGES_PER_CHUNK = 25


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
    import zarr

    zarr.create_array(
        Path(folder) / "poses.zarr",
        shape=(n_images, 4, 4),
        chunks=(min(IMAGES_PER_CHUNK, n_images), 4, 4),
        dtype="float64",
    )


def write_poses(folder: Folder, start: int, T_world_cam: NDArray[np.float64]) -> None:
    """Keep the poses of the images ``start, start + 1, ...`` until the data set is finished."""
    import zarr

    zarr.open_array(Path(folder) / "poses.zarr", mode="r+")[start : start + len(T_world_cam)] = (
        T_world_cam
    )


def read_poses(folder: Folder) -> NDArray[np.float64]:
    """The poses kept by `write_poses`, shape (n_images, 4, 4), [m]."""
    import zarr

    return np.asarray(zarr.open_array(Path(folder) / "poses.zarr", mode="r")[:])


def write_progress(folder: Folder, progress: Progress) -> None:
    """Note how far the data set has come."""
    write_json(Path(folder) / "acquisition.json", progress._asdict())


def read_progress(folder: Folder) -> Progress | None:
    """How far an unfinished data set has come, or None."""
    path = Path(folder) / "acquisition.json"
    if not path.exists():
        return None
    progress = read_json(path, DataSetError)
    return Progress(progress["plan"], int(progress["n_done"]), int(progress.get("n_replaced", 0)))


def forget_progress(folder: Folder) -> None:
    """Remove what is kept of an unfinished data set but its images."""
    shutil.rmtree(Path(folder) / "poses.zarr", ignore_errors=True)
    (Path(folder) / "acquisition.json").unlink(missing_ok=True)
