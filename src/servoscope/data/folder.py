"""The data set folder: ``images.zarr``, ``reference.png``, ``poses.csv`` and ``meta.json``.

``meta.json`` is written last, so a folder that has one is whole. Until then ``acquisition.json``
says what is being made there and how far it has come.
"""

from __future__ import annotations

import csv
import io
import math
import os
import shutil
from array import array
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from servoscope.errors import DataSetError, FolderExistsError, InvalidInputError
from servoscope.poses import poses_from_quaternions, quaternions_xyzw
from servoscope.storage.addresses import DistantStack, fetched, place_of
from servoscope.storage.archives import read_arrays
from servoscope.storage.folders import (
    check_local,
    complete_interrupted,
    complete_replacement,
    owned,
    remove_parts,
    replacing,
    write_arrays,
    write_atomically,
    write_json,
    write_text,
)
from servoscope.storage.reading import (
    LARGEST_JSON,
    LARGEST_TEXT,
    read_grey_png,
    read_json,
    read_lines,
)
from servoscope.storage.stacks import (
    PER_CHUNK,
    Stack,
    create_stack,
    read_stack,
    read_stack_shape,
    write_stack,
)

Folder = str | PathLike[str]

IMAGES_PER_CHUNK = PER_CHUNK

KEPT_IMAGES = "taken.servoscope"
"""The folder of images that are taken until there are enough, within that of the data set."""

VERSION = 1
POSE_COLUMNS = ("name", "tx", "ty", "tz", "qx", "qy", "qz", "qw")
_PARTS = ("acquisition.json", "meta.json", "poses.csv", "reference.png")
_KEPT = ("poses.zarr", KEPT_IMAGES)
_REPLACED = (*reversed(_PARTS[:2]), *_PARTS[2:], "images.zarr", *_KEPT)


_SMALL = {
    **dict.fromkeys(("meta.json", "acquisition.json", "images.zarr/zarr.json"), LARGEST_JSON),
    **dict.fromkeys(("poses.csv", "reference.png"), LARGEST_TEXT),
}
"""What is copied first of a data set at an address, and the most bytes of each."""


def is_data_set(folder: Folder) -> bool:
    """Whether the folder holds a data set, finished or not."""
    return any((Path(folder) / part).exists() for part in ("acquisition.json", "images.zarr"))


def is_finished(folder: Folder) -> bool:
    """Whether the folder holds a whole data set."""
    return (Path(folder) / "meta.json").exists()


def check_free(folder: Folder, *, force: bool = False) -> None:
    """Raise FolderExistsError if a data set cannot be made in the folder.

    A data set that is there may be replaced if `force` is set, or if it is what an interrupted
    `PoseImageSet.save` left. Files of somebody else that bear the name of a part may never be.
    """
    check_local(folder)
    path = Path(folder)
    if path.exists() and not path.is_dir():
        raise FolderExistsError(f"{path} is a file; name a folder.")
    if is_data_set(path):
        if force or _is_abandoned(path):
            return
        raise FolderExistsError(
            f"{path} holds a data set already; name another folder, or replace it with --force."
        )
    for part in (*_PARTS, *_KEPT):
        if (path / part).exists():
            raise FolderExistsError(
                f"{path} holds a {part} that is no part of a data set; name another folder."
            )


@contextmanager
def writing(folder: Folder, *, replace: bool = False, resumable: bool = False) -> Iterator[Path]:
    """Own a folder, and say where a data set for it is to be made.

    With `replace` that is beside the data set that is there, whose place it takes once the block
    ends well; with `resumable` what an earlier block made beside it is gone on with, and left if
    this one fails.
    """
    path = Path(folder)
    with owned(path):
        complete_replacement(path, _REPLACED)
        if not (replace and is_data_set(path)):
            yield path
            return
        with replacing(path, _REPLACED, go_on=resumable, keep=resumable) as place:
            yield place


def remove(folder: Folder) -> None:
    """Remove the data set from the folder, and nothing else that may be in it.

    What shows that there is one goes last, so that an interrupted removal can be repeated.
    """
    path = Path(folder)
    if not is_data_set(path):
        return
    for part in _PARTS[1:]:
        (path / part).unlink(missing_ok=True)
    shutil.rmtree(path / "images.zarr", ignore_errors=True)
    forget_progress(path)
    remove_parts(path)


def create(
    folder: Folder, n_images: int, image_shape: tuple[int, int], plan: dict[str, Any] | None = None
) -> None:
    """Make the folder with an empty stack of images, and note the plan that will fill it.

    Raises
    ------
    FolderExistsError
        If the folder holds a data set already.
    """
    path = Path(folder)
    check_free(path)
    remove(path)
    path.mkdir(parents=True, exist_ok=True)
    write_progress(path, Progress(plan or {}, 0))
    create_stack(path / "images.zarr", (n_images, *image_shape), "uint8")


def write_images(folder: Folder, start: int, images: NDArray[np.uint8]) -> None:
    """Write images at positions ``start, start + 1, ...`` of the stack."""
    write_stack(Path(folder) / "images.zarr", start, images)


def finish(
    folder: Folder,
    *,
    reference_image: NDArray[np.uint8],
    T_world_ref: NDArray[np.float64],
    T_world_cam: NDArray[np.float64],
    names: Sequence[str],
    times: NDArray[np.float64] | None,
    meta: dict[str, Any],
) -> None:
    """Write all but the images; the folder is a whole data set from then on."""
    path = Path(folder)
    _, png = cv2.imencode(".png", reference_image)
    write_atomically(path / "reference.png", lambda file: file.write(png.tobytes()))
    write_text(path / "poses.csv", _poses_as_csv(T_world_cam, names, times))
    reference = dict(zip(POSE_COLUMNS[1:], _pose_numbers(T_world_ref[None])[0], strict=True))
    write_json(path / "meta.json", {"version": VERSION, "reference": reference, **meta})
    forget_progress(path)


def read_meta(folder: Folder) -> dict[str, Any]:
    """The content of ``meta.json``; a replacement that was interrupted is completed first."""
    path = Path(folder)
    if not path.is_dir():
        raise DataSetError(f"{path} is not a folder; name a data set folder.")
    if not is_finished(path):
        complete_interrupted(path, _REPLACED)
    progress = read_progress(path)
    if not (path / "meta.json").exists():
        if progress is not None:
            raise DataSetError(
                f"{path} is unfinished ({progress.n_done} images); repeat the command that began "
                "it."
            )
        raise DataSetError(
            f"{path} is not a data set folder: it has no meta.json; name one that acquire or "
            "import wrote."
        )
    meta = read_json(path / "meta.json", DataSetError)
    if meta.get("version") != VERSION:
        raise DataSetError(
            f"{path / 'meta.json'} has version {meta.get('version')!r}, this servoscope reads "
            f"version {VERSION}; make the data set again."
        )
    missing = {"reference", "pivot", "pivot_ranges", "split", "source"} - meta.keys()
    if missing:
        raise DataSetError(f"{path / 'meta.json'} lacks {', '.join(sorted(missing))}.")
    if not isinstance(meta["source"], dict):
        raise DataSetError(f"{path / 'meta.json'} must have an object as source.")
    return meta


def read(folder: Folder, in_memory: float = math.inf) -> dict[str, Any]:
    """Everything in a data set folder, under the names of `PoseImageSet`'s fields and ``meta``.

    The folder may be at an address of another file system. Images of more than `in_memory` bytes
    are a `Stack`.

    Raises
    ------
    DataSetError
        If the folder is missing, unfinished, damaged or of another version.
    """
    place = place_of(folder)
    if isinstance(place, Path):
        return _read(place, Stack, in_memory)
    with fetched(place, _SMALL) as path:
        return _read(path, partial(DistantStack, f"{place}/images.zarr"), in_memory)


def _read(path: Path, open_stack: Callable[..., Stack], in_memory: float) -> dict[str, Any]:
    meta = read_meta(path)
    shape = read_stack_shape(path / "images.zarr", 3, "uint8")
    names, numbers, times = _read_poses(path / "poses.csv", shape[0])
    reference_image = read_grey_png(path / "reference.png", (shape[1], shape[2]), DataSetError)
    stack = open_stack(path / "images.zarr", shape, "uint8")
    images = stack if stack.nbytes > in_memory else stack[:]
    try:
        T_world_cam = poses_from_quaternions(numbers[:, :3], numbers[:, 3:])
        reference = np.array([[float(meta["reference"][key]) for key in POSE_COLUMNS[1:]]])
        T_world_ref = poses_from_quaternions(reference[:, :3], reference[:, 3:])[0]
    except (InvalidInputError, KeyError, TypeError, ValueError) as error:
        raise DataSetError(f"{path}: {error}") from error
    return {
        "images": images,
        "T_world_cam": T_world_cam,
        "T_world_ref": T_world_ref,
        "reference_image": reference_image,
        "names": names,
        "times": times,
        "meta": meta,
    }


def _is_abandoned(path: Path) -> bool:
    """Whether the folder holds what an interrupted `PoseImageSet.save` left."""
    try:
        progress = read_progress(path)
    except DataSetError:
        return False
    return progress is not None and not progress.plan


def _read_poses(
    path: Path, n_images: int
) -> tuple[list[str], NDArray[np.float64], NDArray[np.float64] | None]:
    names, numbers, times, n_poses = [], array("d"), array("d"), 0
    try:
        rows = csv.reader(read_lines(path, DataSetError, newline=""))
        header = next(rows, [])
        wanted = [header.index(column) for column in POSE_COLUMNS]
        time = header.index("time") if "time" in header else None
        for n_poses, row in enumerate(rows, start=1):
            if n_poses > n_images:
                continue
            if len(row) != len(header):
                raise ValueError(f"line {rows.line_num} has {len(row)} cells")
            names.append(row[wanted[0]])
            numbers.extend(float(row[i]) for i in wanted[1:])
            if time is not None:
                times.append(float(row[time]))
    except (csv.Error, ValueError) as error:
        if isinstance(error, DataSetError):
            raise
        raise DataSetError(
            f"{path} must have the columns {','.join(POSE_COLUMNS)} ({error}); make the data set "
            "again."
        ) from error
    if n_poses != n_images:
        raise DataSetError(
            f"{path} has {n_poses} poses for {n_images} images; make the data set again."
        )
    return names, np.array(numbers).reshape(-1, 7), None if time is None else np.array(times)


def _pose_numbers(T: NDArray[np.float64]) -> list[list[float]]:
    return np.hstack([T[:, :3, 3], quaternions_xyzw(T)]).tolist()


def _poses_as_csv(
    T_world_cam: NDArray[np.float64], names: Sequence[str], times: NDArray[np.float64] | None
) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(POSE_COLUMNS if times is None else (*POSE_COLUMNS, "time"))
    for i, numbers in enumerate(_pose_numbers(T_world_cam)):
        row = [names[i], *map(repr, numbers)]
        writer.writerow(row if times is None else [*row, repr(float(times[i]))])
    return text.getvalue()


class Progress(NamedTuple):
    """How far an unfinished data set has come:

    what is being made, how many images are written, and how many of their poses could not be
    reached and were drawn anew.
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
    folder: Folder, i: int, image: NDArray[np.uint8], pose: NDArray[np.float64], number: int
) -> None:
    """Keep image i with its pose and a number of the caller's, whole or not at all."""
    kept = Path(folder) / KEPT_IMAGES
    kept.mkdir(exist_ok=True)
    arrays: dict[str, NDArray[Any]] = {"image": image, "pose": pose}
    arrays["number"] = np.array(number)
    write_arrays(kept / f"{i:06d}.npz", arrays)


def kept_images(
    folder: Folder,
) -> tuple[NDArray[np.uint8], NDArray[np.float64], NDArray[np.int_]]:
    """Images kept by `keep_image`, their poses, and the numbers kept with them, in order.

    Raises
    ------
    DataSetError
        If one of them is damaged.
    """
    kept: list[dict[str, NDArray[Any]]] = []
    while (path := Path(folder) / KEPT_IMAGES / f"{len(kept):06d}.npz").exists():
        arrays = read_arrays(path, ("image", "pose", "number"), DataSetError)
        image, pose = arrays["image"], arrays["pose"]
        alike = not kept or image.shape == kept[0]["image"].shape
        if image.dtype != np.uint8 or image.ndim != 2 or pose.shape != (4, 4) or not alike:
            raise DataSetError(f"{path} holds no image with its pose; begin again with --force.")
        kept.append(arrays)
    if not kept:
        return np.empty((0, 0, 0), np.uint8), np.empty((0, 4, 4)), np.empty(0, int)
    images, poses, numbers = (
        np.stack([arrays[name] for arrays in kept]) for name in ("image", "pose", "number")
    )
    return images, poses, numbers


def drop_kept(folder: Folder, start: int) -> None:
    """Remove the kept images ``start, start + 1, ...``, the last first."""
    kept = Path(folder) / KEPT_IMAGES
    for path in sorted(kept.glob("[0-9]*.npz"), reverse=True):
        if int(path.stem) >= start:
            path.unlink()


def keep_reference(folder: Folder, image: NDArray[np.uint8]) -> None:
    """Keep the reference image until the data set is finished."""
    kept = Path(folder) / KEPT_IMAGES
    kept.mkdir(exist_ok=True)
    write_arrays(kept / "reference.npz", {"image": image})


def kept_reference(folder: Folder) -> NDArray[np.uint8]:
    """The reference image kept by `keep_reference`.

    Raises
    ------
    DataSetError
        If it is missing or damaged.
    """
    path = Path(folder) / KEPT_IMAGES / "reference.npz"
    image = read_arrays(path, ("image",), DataSetError)["image"]
    if image.dtype != np.uint8 or image.ndim != 2:
        raise DataSetError(f"{path} holds no image; begin again with --force.")
    return image


def finish_kept(folder: Folder, images: NDArray[np.uint8], **rest: Any) -> None:
    """Write images that were kept one by one, and all the rest as `finish` does."""
    shutil.rmtree(Path(folder) / "images.zarr", ignore_errors=True)
    create_stack(Path(folder) / "images.zarr", images.shape, "uint8")
    write_images(folder, 0, images)
    finish(folder, **rest)


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
