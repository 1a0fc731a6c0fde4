"""From frames to a data set: the reference, its neighbourhood, and the images."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import asdict

import numpy as np
from numpy.typing import NDArray

from servoscope.dataset import PoseImageSet
from servoscope.errors import DataSetError, ServoscopeWarning
from servoscope.formats.drops import BAD_IMAGE, FAR, Drops
from servoscope.formats.frames import Frames
from servoscope.formats.images import GreyImage, read_grey, read_stack, which_readable
from servoscope.formats.neighbourhood import choose_reference, near_reference
from servoscope.formats.options import ImportOptions


def assemble_data_set(
    frames: Frames,
    options: ImportOptions,
    drops: Drops,
    format_name: str,
    on_progress: Callable[[int], object] | None = None,
) -> PoseImageSet:
    """Read the images around the reference, and join them with their poses.

    The reference frame gives the reference image and pose, and stays in the set with
    displacement zero.

    Parameters
    ----------
    frames : Frames
    options : ImportOptions
    drops : Drops
        What was left out so far; what this leaves out is added.
    format_name : str
        Noted in the source of the data set.
    on_progress : callable, optional
        Called with the number of images read.

    Returns
    -------
    PoseImageSet
        Its ``source`` notes the format, the options, the reference, how many frames were kept
        and how many were left out for which reason.

    Raises
    ------
    DataSetError
        If an image is unreadable or of another size and is not to be skipped, or fewer than two
        frames are left.

    Warns
    -----
    ServoscopeWarning
        If anything was left out, with counts and reasons.
    """
    split = _choose_split(frames, options)
    frames, reference, reference_image = _take_reference(frames, options, drops)
    near = near_reference(frames, reference, options.max_mm, options.max_deg)
    T_world_ref, reference_name = frames.T_world_cam[reference], frames.names[reference]
    frames = _keep(frames, near, FAR, drops)
    frames, images = _read_images(frames, reference_image, options, drops, on_progress)
    if drops.counts():
        kept = f"{frames.folder}: {len(frames)} frames kept; left out: {drops}."
        warnings.warn(kept, ServoscopeWarning, stacklevel=3)
    return PoseImageSet(
        images=images,
        T_world_cam=frames.T_world_cam,
        T_world_ref=T_world_ref,
        reference_image=reference_image,
        names=frames.names,
        pivot=options.pivot_mm / 1e3,
        times=frames.times,
        split=split,
        source={
            "format": format_name,
            "folder": str(frames.folder),
            "options": asdict(options),
            "reference": reference_name,
            "n_kept": len(frames),
            "dropped": drops.counts(),
        },
    )


def _choose_split(frames: Frames, options: ImportOptions) -> str:
    if options.split == "blocks" and frames.times is None:
        raise DataSetError(
            f"{frames.folder}: a split by blocks needs the time of each image, which is not "
            "known; add a column 'time' to poses.csv, or use --split random."
        )
    if options.split == "auto":
        return "random" if frames.times is None else "blocks"
    return options.split


def _take_reference(
    frames: Frames, options: ImportOptions, drops: Drops
) -> tuple[Frames, int, GreyImage]:
    _check_enough(frames, drops)
    reference = choose_reference(frames, options)
    try:
        return frames, reference, read_grey(frames.paths[reference], options.image_width)
    except DataSetError:
        if options.names_reference or not options.skip_bad:
            raise
    frames = _keep(frames, which_readable(frames.paths), BAD_IMAGE, drops)
    return _take_reference(frames, options, drops)


def _read_images(
    frames: Frames,
    reference_image: GreyImage,
    options: ImportOptions,
    drops: Drops,
    on_progress: Callable[[int], object] | None,
) -> tuple[Frames, NDArray[np.uint8]]:
    height, width = reference_image.shape
    images, errors = read_stack(frames.paths, (height, width), options.image_width, on_progress)
    bad = [error for error in errors if error is not None]
    if not bad:
        return frames, images
    if not options.skip_bad:
        raise bad[0]
    readable = np.array([error is None for error in errors])
    frames = _keep(frames, readable, BAD_IMAGE, drops)
    _check_enough(frames, drops)
    return frames, images[readable]


def _keep(frames: Frames, kept: NDArray[np.bool_], reason: str, drops: Drops) -> Frames:
    drops.add(reason, frames.take(~kept).names)
    return frames.take(kept)


def _check_enough(frames: Frames, drops: Drops) -> None:
    if len(frames) < 2:
        left_out = f"; left out: {drops}" if drops.counts() else ""
        raise DataSetError(
            f"{frames.folder}: {len(frames)} image{'s' * (len(frames) != 1)} with a pose, but a "
            f"data set needs two at least{left_out}."
        )
