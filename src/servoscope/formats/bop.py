"""A scene of the BOP benchmark: ``scene_gt.json`` and ``scene_camera.json``, beside the images."""

from __future__ import annotations

import os
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
from servoscope.formats.frames import Drops, Frames
from servoscope.formats.options import Direction, ImportOptions, Units
from servoscope.formats.pose_text import as_T_world_cam, check_folder
from servoscope.formats.scaled import usable_matrices
from servoscope.storage.reading import LARGEST_TEXT, read_json

WITHOUT_OBJECT = "without the object"
_FOLDERS = ("rgb", "gray", "rgb_cam1", "gray_cam1")


@dataclass(frozen=True, kw_only=True)
class BopOptions(ImportOptions):
    """Options of a scene of BOP, besides those of every format.

    Parameters
    ----------
    object : str, optional
        Number of the object that stands for the world, or world for the scene's own
        (cam_R_w2c in scene_camera.json); the only object by default.
    images : str, optional
        Folder within SRC that holds the images; rgb or gray by default.
    direction : {"world-to-camera", "camera-to-world"}
        What the poses map; BOP writes object to camera.

    Examples
    --------
    >>> BopOptions(object="3").length_unit
    'mm'
    """

    object: str | None = None
    images: str | None = None
    direction: Direction = "world-to-camera"

    @property
    def length_unit(self) -> Units:
        """Unit of the translations: millimetres, if nothing else is said."""
        return self.units or "mm"


def read_bop(
    src: str | PathLike[str],
    options: BopOptions | None = None,
    on_progress: Callable[[int], object] | None = None,
) -> PoseImageSet:
    """Data set from a scene of BOP, with one of its objects as the world.

    ``scene_gt.json`` gives for each image the pose of each object in the camera's frame
    (``cam_R_m2c``, ``cam_t_m2c`` [mm]); ``scene_camera.json`` that of the scene (``cam_R_w2c``).

    Parameters
    ----------
    src : path-like
        Folder of one scene.
    options : BopOptions, optional
    on_progress : callable, optional
        Called with the number of images read.

    Returns
    -------
    PoseImageSet
        In the order of the images' numbers.

    Raises
    ------
    DataSetError
        If a file is missing, damaged or inconsistent, the object must be chosen, or is twice in an
        image.

    Warns
    -----
    ServoscopeWarning
        If anything was left out, with counts and reasons.

    References
    ----------
    T. Hodaň et al., "BOP: Benchmark for 6D object pose estimation", ECCV 2018.

    Examples
    --------
    >>> data = read_bop("000001", BopOptions(object="3"))  # doctest: +SKIP
    """
    options = BopOptions() if options is None else options
    folder, drops = Path(src), Drops()
    file = "scene_camera.json" if options.object == "world" else "scene_gt.json"
    check_folder(folder, file)
    path = folder / file
    entries = _by_number(read_json(path, DataSetError, LARGEST_TEXT), path)
    place = _images(folder, options)
    if options.object == "world":
        found = {n: _matrix(e, "w2c", f"{path}, image {n}") for n, e in entries.items()}
    else:
        found = _of_object(entries, options, path)
    names = _names(folder, place, list(entries))
    drops.add(WITHOUT_OBJECT, [names[number] for number in entries if number not in found])
    if not found:
        raise DataSetError(f"{path}: no image shows the object {options.object}.")
    numbers = list(found)
    places = [f"{path}, image {number}" for number in numbers]
    kept = [names[number] for number in numbers]
    usable = usable_matrices(list(found.values()), places, kept, options, drops)
    T = poses_from_numbers(
        np.array(list(found.values()))[usable].reshape(-1, 12),
        CONVENTIONS["matrix"],
        length_unit=options.length_unit,
    )
    frames = Frames(
        folder,
        [name for name, use in zip(kept, usable, strict=True) if use],
        np.array(numbers)[usable],
        as_T_world_cam(T, direction=options.direction, axes=options.axes),
    )
    return assemble_data_set(frames, options, drops, "bop", on_progress)


def _by_number(scene: dict[str, Any], path: Path) -> dict[int, Any]:
    try:
        return {number: scene[str(number)] for number in sorted(map(int, scene))}
    except (ValueError, KeyError) as error:
        raise DataSetError(f"{path} must have the numbers of images as keys ({error}).") from error


def _of_object(entries: dict[int, Any], options: BopOptions, path: Path) -> dict[int, np.ndarray]:
    """Pose of the object by image."""
    for number, shown in entries.items():
        if not isinstance(shown, list) or not all(isinstance(one, dict) for one in shown):
            raise DataSetError(f"{path}, image {number}: must be a list of objects.")
    objects = sorted({str(one.get("obj_id")) for shown in entries.values() for one in shown})
    wanted = options.object
    if wanted is None and len(objects) == 1:
        wanted = objects[0]
    if wanted not in objects:
        raise DataSetError(
            f"{path} shows the objects {', '.join(objects[:20]) or 'none'}; choose the one that "
            "stands for the world with --object, or --object world."
        )
    found = {}
    for number, shown in entries.items():
        own = [one for one in shown if str(one.get("obj_id")) == wanted]
        if len(own) > 1:
            if not options.skip_bad:
                raise DataSetError(
                    f"{path}, image {number}: shows the object {wanted} {len(own)} times, so that "
                    "its pose is not known; choose another, or leave such images out with "
                    "--skip-bad."
                )
            continue
        if own:
            found[number] = _matrix(own[0], "m2c", f"{path}, image {number}")
    return found


def _matrix(entry: Any, kind: str, where: str) -> np.ndarray:
    """Rotation and translation as three rows of four numbers."""
    try:
        R = np.array(entry[f"cam_R_{kind}"], dtype=float).reshape(3, 3)
        t = np.array(entry[f"cam_t_{kind}"], dtype=float).reshape(3, 1)
    except (KeyError, TypeError, ValueError) as error:
        raise DataSetError(
            f"{where}: must have cam_R_{kind} of 9 numbers and cam_t_{kind} of 3."
        ) from error
    return np.hstack([R, t])


def _images(folder: Path, options: BopOptions) -> str:
    places = _FOLDERS if options.images is None else (options.images,)
    for place in places:
        if (folder / place).is_dir():
            return place
    raise DataSetError(
        f"{folder} has no folder of images {', '.join(places)}; name it with --images."
    )


def _names(folder: Path, place: str, numbers: list[int]) -> dict[int, str]:
    """Name of each image, whatever its ending; of one that is missing, as it would be."""
    by_stem = {Path(name).stem: name for name in sorted(os.listdir(folder / place))}
    return {
        number: f"{place}/{by_stem.get(f'{number:06d}', f'{number:06d}.png')}" for number in numbers
    }
