"""A ``transforms.json``, as nerfstudio, instant-ngp and Blender's NeRF data sets have it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from servoscope.data.images import PoseImageSet
from servoscope.errors import DataSetError
from servoscope.formats.assembly import assemble_data_set
from servoscope.formats.conventions import CONVENTIONS, poses_from_numbers
from servoscope.formats.frames import Drops, Frames, check_names_differ
from servoscope.formats.options import Axes
from servoscope.formats.pose_text import as_T_world_cam, check_folder, relative_name
from servoscope.formats.scaled import ScaledOptions, usable_matrices
from servoscope.storage.reading import LARGEST_TEXT, read_json


@dataclass(frozen=True, kw_only=True)
class NerfstudioOptions(ScaledOptions):
    """Options of a transforms.json, besides those of every reconstruction.

    Parameters
    ----------
    transforms : str
        Name of the file within SRC.
    axes : {"opengl", "opencv"}
        Camera axes of the poses; nerfstudio has those of OpenGL.

    Examples
    --------
    >>> NerfstudioOptions(transforms="transforms_train.json", scale=0.4).axes
    'opengl'
    """

    transforms: str = "transforms.json"
    axes: Axes = "opengl"


def read_nerfstudio(
    src: str | PathLike[str],
    options: NerfstudioOptions | None = None,
    on_progress: Callable[[int], object] | None = None,
) -> PoseImageSet:
    """Data set from a ``transforms.json`` and the images that it names.

    Each of its ``frames`` has a ``file_path`` and a ``transform_matrix`` from camera to world, with
    the camera axes of OpenGL: x right, y up, z backward.

    Parameters
    ----------
    src : path-like
    options : NerfstudioOptions, optional
    on_progress : callable, optional
        Called with the number of images read.

    Returns
    -------
    PoseImageSet
        In the order of the file.

    Raises
    ------
    DataSetError
        If a file is missing, damaged or inconsistent.

    Warns
    -----
    ServoscopeWarning
        If the scale is not said, or anything was left out.

    Examples
    --------
    >>> data = read_nerfstudio("part", NerfstudioOptions(scale=0.4))  # doctest: +SKIP
    """
    options = NerfstudioOptions() if options is None else options
    folder, drops = Path(src), Drops()
    check_folder(folder, options.transforms)
    path = folder / options.transforms
    listed = read_json(path, DataSetError, LARGEST_TEXT).get("frames")
    if not isinstance(listed, list) or not listed:
        raise DataSetError(f"{path} must hold a list 'frames' with an entry for each image.")
    names = [_name(entry, folder, f"{path}, frame {i}") for i, entry in enumerate(listed)]
    check_names_differ(names, path)
    places = [f"{path}, frame {i}" for i in range(len(listed))]
    matrices = [_matrix(entry, place) for entry, place in zip(listed, places, strict=True)]
    usable = usable_matrices(matrices, places, names, options, drops)
    numbers = np.array(matrices)[usable].reshape(-1, 12)
    T = poses_from_numbers(numbers, CONVENTIONS["matrix"], length_unit="m")
    T[:, :3, 3] *= options.metres(folder)
    frames = Frames(
        folder,
        [name for name, use in zip(names, usable, strict=True) if use],
        np.flatnonzero(usable),
        as_T_world_cam(T, direction=options.direction, axes=options.axes),
    )
    return assemble_data_set(frames, options, drops, "nerfstudio", on_progress)


def _name(entry: Any, folder: Path, where: str) -> str:
    """Name of the image; Blender's data sets leave out the ending."""
    name = entry.get("file_path") if isinstance(entry, dict) else None
    if not isinstance(name, str):
        raise DataSetError(f"{where}: must have a 'file_path' that is text.")
    name = relative_name(name, where)
    return name if Path(name).suffix or (folder / name).exists() else f"{name}.png"


def _matrix(entry: dict[str, Any], where: str) -> np.ndarray:
    """The upper three rows of the matrix."""
    try:
        matrix = np.array(entry["transform_matrix"], dtype=float)
    except (KeyError, TypeError, ValueError):
        matrix = np.empty(0)
    if matrix.shape not in ((4, 4), (3, 4)):
        raise DataSetError(
            f"{where}: must have a 'transform_matrix' of 4 rows of 4 numbers, got the shape "
            f"{matrix.shape}."
        )
    if len(matrix) == 4 and not np.allclose(matrix[3], [0, 0, 0, 1], atol=1e-6):
        raise DataSetError(
            f"{where}: the last row of the matrix must be 0 0 0 1, got {matrix[3].tolist()}."
        )
    return matrix[:3]
