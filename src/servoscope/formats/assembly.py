"""From frames to a data set: the reference, its neighbourhood, and the images."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.data.images import PoseImageSet, images_share
from servoscope.errors import DataSetError, ServoscopeWarning
from servoscope.formats.frames import (
    BAD_IMAGE,
    FAR,
    HELD_POSE,
    THINNED,
    Drops,
    Frames,
    held_poses,
)
from servoscope.formats.images import (
    GreyLevels,
    filled_bits,
    stack_images,
    to_eight_bits,
)
from servoscope.formats.neighbourhood import choose_reference, near_reference
from servoscope.formats.options import ImportOptions
from servoscope.poses import pose_error
from servoscope.storage.stacks import some_of

MOST_BYTES = 2**29
"""Most bytes of images that are kept of a bag or a video."""


def assemble_data_set(
    frames: Frames,
    options: ImportOptions,
    drops: Drops,
    format_name: str,
    on_progress: Callable[[int], object] | None = None,
    facts: dict[str, Any] | None = None,
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
    facts : dict, optional
        What else is noted in the source of the data set, as plain JSON values.

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
        If anything was left out, with counts and reasons, or images or poses cannot be right.
    """
    from servoscope.data.checks import check_poses, fault_words, image_faults

    split, unfit = _choose_split(frames, options), np.array([], dtype=str)
    while True:
        frames, reference, levels, brightest = _take_reference(frames, unfit, options, drops)
        near = near_reference(frames, reference, options.max_mm, options.max_deg)
        kept_places = _thinned(frames, near, reference, levels, options)
        kept, stack, largest = _read_images(
            frames.at(kept_places), levels, options, drops, on_progress
        )
        bits = _filled_bits(levels, max(brightest, largest), frames.folder, options)
        images, reference_image = to_eight_bits(stack, bits), to_eight_bits(levels[None], bits)[0]
        faults = image_faults(images, kept.T_world_cam) | {HELD_POSE: held_poses(images, kept)}
        if _is_fit(frames.names[reference], kept, faults, options):
            break
        bad = np.any(list(faults.values()), axis=0)
        unfit = np.union1d(unfit, kept.take(bad).names)
    reference_name, far_names = frames.names[reference], frames.take(~near).names
    near[kept_places] = False
    drops.add(THINNED, frames.take(near).names)
    if options.skip_bad:
        for reason, is_bad in faults.items():
            drops.add(reason, kept.take(is_bad).names)
        sound = ~np.any(list(faults.values()), axis=0)
        kept, images = kept.take(sound), some_of(images, sound)
        _check_enough(kept, drops)
    elif found := fault_words(faults, kept.names):
        _warn(f"{kept.folder}: of {len(kept)} images {found}; leave them out with --skip-bad.")
    drops.add(FAR, far_names)
    if drops.counts():
        _warn(f"{kept.folder}: {len(kept)} frames kept; left out: {drops}.")
    data = PoseImageSet(
        images=images,
        T_world_cam=kept.T_world_cam,
        T_world_ref=frames.T_world_cam[reference],
        reference_image=reference_image,
        names=kept.names,
        pivot=options.pivot_mm / 1e3,
        times=kept.times,
        split=split,
        source={
            "format": format_name,
            "folder": str(kept.folder),
            "options": {**_noted(options), "units": options.length_unit},
            "reference": reference_name,
            "n_kept": len(kept),
            "dropped": drops.counts(),
            **(facts or {}),
            **({} if levels.dtype == np.uint8 else {"bit_depth": bits}),
        },
    )
    texts = [finding.text for finding in check_poses(data)]
    for text in (*texts, *_too_near(data, options)):
        _warn(f"{kept.folder}: {text}")
    return data


def _noted(options: ImportOptions) -> dict[str, Any]:
    """The options that the data set depends on."""
    return {name: value for name, value in asdict(options).items() if name != "memory"}


def _warn(text: str) -> None:
    warnings.warn(text, ServoscopeWarning, stacklevel=4)


def _filled_bits(levels: GreyLevels, brightest: int, folder: Path, options: ImportOptions) -> int:
    if levels.dtype != np.uint8:
        return filled_bits(brightest, options.bit_depth, str(folder))
    if options.bit_depth not in (None, 8):
        raise DataSetError(
            f"{folder}: its images are of 8 bits, so that --bit-depth {options.bit_depth} cannot "
            "be; leave it out."
        )
    return 8


def _is_fit(
    name: str, frames: Frames, faults: dict[str, NDArray[np.bool_]], options: ImportOptions
) -> bool:
    """Whether a frame can be the reference; one that the user named must be, or is refused."""
    found = [reason for reason, is_bad in faults.items() if name in frames.take(is_bad).names]
    if not found or not options.names_reference:
        return not found
    if not options.skip_bad and found[0] not in ("black", "saturated", "flat"):
        return True
    raise DataSetError(
        f"{frames.folder}: the reference {name} is {found[0]}; name another with --reference."
    )


def _too_near(data: PoseImageSet, options: ImportOptions) -> list[str]:
    """What metres that were taken for millimetres look like."""
    mm = 1e3 * pose_error(data.T_world_ref, data.T_world_cam)[0]
    if options.length_unit != "mm" or not 1e-6 < mm.max() < 0.5:
        return []
    return [
        f"Cameras are within {mm.max():.3g} mm of the reference: check that the positions are in "
        "mm, or say --units m."
    ]


def _choose_split(frames: Frames, options: ImportOptions) -> str:
    if options.split == "blocks" and frames.times is None:
        raise DataSetError(
            f"{frames.folder}: a split by blocks needs the time of each image, which is not "
            "known; add a column 'time' to poses.csv, or use --split random."
        )
    if options.split == "auto":
        return "random" if frames.times is None else "blocks"
    return options.split


def _thinned(
    frames: Frames,
    near: NDArray[np.bool_],
    reference: int,
    levels: GreyLevels,
    options: ImportOptions,
) -> NDArray[np.intp]:
    """Places of the frames that are kept of those near the reference: evenly chosen, if too many.

    Those of a stream, which may be far larger than the memory, take `MOST_BYTES` at most.
    """
    places = np.flatnonzero(near)
    most = len(places) if options.max_images is None else options.max_images
    if frames.read is not None:
        fit = max(2, MOST_BYTES // levels.nbytes)
        if options.max_images is not None and min(most, len(places)) > fit:
            raise DataSetError(
                f"{frames.folder}: {min(most, len(places))} images of {levels.shape[1]} x "
                f"{levels.shape[0]} px are more than {MOST_BYTES / 1e6:.0f} MB, which hold {fit}; "
                "give a smaller --image-width, or fewer by --max-images."
            )
        most = min(most, fit)
    if len(places) <= most:
        return places
    at = np.unique(np.linspace(0, len(places) - 1, most).round().astype(np.intp))
    at[np.abs(places[at] - reference).argmin()] = np.searchsorted(places, reference)
    return places[np.unique(at)]


def _take_reference(
    frames: Frames, unfit: NDArray[np.str_], options: ImportOptions, drops: Drops
) -> tuple[Frames, int, GreyLevels, int]:
    """The frames, the position of the reference among them, its grey levels and the largest."""
    _check_enough(frames, drops)
    fit = np.flatnonzero(~np.isin(frames.names, unfit))
    if not fit.size:
        raise DataSetError(
            f"{frames.folder}: none of {len(frames)} images can be the reference: they are black, "
            "saturated, flat or repeated, or their poses stay; check the camera."
        )
    reference = int(fit[choose_reference(frames.at(fit), options)])
    with closing(frames.at(np.array([reference])).images(options.image_width)) as images:
        decoded = next(images)
    if not isinstance(decoded, DataSetError):
        return frames, reference, *decoded
    if options.names_reference or not options.skip_bad:
        raise decoded
    readable = [not isinstance(image, DataSetError) for image in frames.images()]
    frames = _keep(frames, np.array(readable), BAD_IMAGE, drops)
    return _take_reference(frames, unfit, options, drops)


def _read_images(
    frames: Frames,
    reference: GreyLevels,
    options: ImportOptions,
    drops: Drops,
    on_progress: Callable[[int], object] | None,
) -> tuple[Frames, GreyLevels, int]:
    """The frames whose images can be read, the images, and their largest grey level."""
    decoded = frames.images(options.image_width)
    images, largest, errors = stack_images(
        decoded,
        frames.paths,
        reference,
        on_progress,
        skip_bad=options.skip_bad,
        in_memory=images_share(options.memory),
    )
    if not any(errors):
        return frames, images, largest
    readable = np.array([error is None for error in errors])
    frames = _keep(frames, readable, BAD_IMAGE, drops)
    _check_enough(frames, drops)
    return frames, some_of(images, readable), largest


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
