"""What cannot be right in a data set: images that show nothing, and poses that no part allows."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from hashlib import blake2b
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.data.images import PoseImageSet
from servoscope.poses import pose_error

IMAGE_FAULTS = ("black", "saturated", "flat", "repeated")
"""Why an image is of no use: nearly black, nearly all white, one grey, or the same as another that
was taken elsewhere, as of a camera that froze."""

BLACK_LEVEL, WHITE_LEVEL = 8, 254
"""Grey levels up to which an image is black, and from which pixels are saturated."""

MOST_SATURATED = 0.95
"""Share of saturated pixels above which an image is of no use."""

LEAST_CONTRAST = 1.0
"""Standard deviation of the grey levels, averaged over blocks, below which an image is flat."""

FAR_IN_PIVOTS, MEDIAN_FAR_IN_PIVOTS = 4.0, 2.0
"""How far from the reference cameras can be, the farthest and half of them, in distances of the
part."""

_PIXELS_LOOKED_AT = 2**18
_IMAGES_PER_BLOCK = 64
_NAMES_SHOWN = 3


def image_faults(
    images: NDArray[np.uint8], T_world_cam: NDArray[np.float64]
) -> dict[str, NDArray[np.bool_]]:
    """Which images are of no use, by reason; each image has one at most.

    Parameters
    ----------
    images : ndarray of shape (n_images, height, width), uint8
    T_world_cam : ndarray of shape (n_images, 4, 4)
        [m].

    Returns
    -------
    dict of ndarray of shape (n_images,), bool
        By `IMAGE_FAULTS`. The first of images that repeat is sound.

    Examples
    --------
    >>> images = np.zeros((2, 8, 8), np.uint8)
    >>> images[1, :, 4:] = 100
    >>> image_faults(images, np.stack([np.eye(4)] * 2))["black"]
    array([ True, False])
    """
    step = max(1, round(np.sqrt(images[0].size / _PIXELS_LOOKED_AT)))
    some = images[:, ::step, ::step]
    parts = [
        _grey_levels(some[start : start + _IMAGES_PER_BLOCK])
        for start in range(0, len(images), _IMAGES_PER_BLOCK)
    ]
    bright, saturated, contrast = (np.concatenate(part) for part in zip(*parts, strict=True))
    black = bright <= BLACK_LEVEL
    white = ~black & (saturated > MOST_SATURATED)
    usual = np.median(contrast[~black & ~white]) if (~black & ~white).any() else 0.0
    flat = ~black & ~white & (contrast < min(LEAST_CONTRAST, max(0.25 * usual, 1e-9)))
    repeated = _repeated(images, T_world_cam, ~(black | white | flat))
    return dict(zip(IMAGE_FAULTS, (black, white, flat, repeated), strict=True))


def fault_words(faults: dict[str, NDArray[np.bool_]], names: Iterable[str]) -> str:
    """How many images have which fault, with some of their names; empty if none has.

    Examples
    --------
    >>> fault_words({"black": np.array([True, False])}, ["a.png", "b.png"])
    '1 black (a.png)'
    """
    names = np.array(list(names), dtype=object)
    parts = []
    for reason, is_bad in faults.items():
        if is_bad.any():
            shown = names[is_bad].tolist()
            if len(shown) > _NAMES_SHOWN:
                shown = [*shown[: _NAMES_SHOWN - 1], "..."]
            parts.append(f"{is_bad.sum()} {reason} ({', '.join(shown)})")
    return ", ".join(parts)


def data_set_warnings(
    data: PoseImageSet, faults: dict[str, NDArray[np.bool_]] | None = None
) -> list[str]:
    """What is wrong with the images and poses of a data set, a sentence each.

    Parameters
    ----------
    data : PoseImageSet
    faults : dict of ndarray, optional
        What `image_faults` finds in it, if that is known.
    """
    texts = pose_warnings(data)
    if faults is None:
        faults = image_faults(data.images, data.T_world_cam)
    if words := fault_words(faults, data.names):
        advice = "take them anew, or leave them out"
        if _is_imported(data):
            advice = "import with --skip-bad leaves them out"
        texts.insert(0, f"Of {len(data)} images some are of no use: {words}; {advice}.")
    return texts


def pose_warnings(data: PoseImageSet) -> list[str]:
    """What is wrong with the displacements of a data set, a sentence each.

    Cameras farther from the reference than the part lies before it do not see the part: usually the
    unit is wrong. Euler angles jump from 180 to -180 degrees, and about x and z where that about y
    comes near 90 degrees: such targets cannot be learned.
    """
    texts, units, to_mm, to_deg = [], "", "", ""
    if _is_imported(data):
        units, to_mm, to_deg = " (--units mm?)", " with --max-mm", " with --max-deg"
    if len(data) > 1 and not data.moves().any():
        texts.append("All images have one pose: nothing can be learned from them.")
    mm = 1e3 * pose_error(data.T_world_ref, data.T_world_cam)[0]
    part_mm = 1e3 * max(abs(data.pivot), 0.25)
    if mm.max() > FAR_IN_PIVOTS * part_mm or np.median(mm) > MEDIAN_FAR_IN_PIVOTS * part_mm:
        part = f", though the part is taken to be {1e3 * abs(data.pivot):.6g} mm before it"
        texts.append(
            f"Cameras are up to {mm.max():.6g} mm from the reference (half of them beyond "
            f"{np.median(mm):.6g} mm){part if data.pivot else ''}: check the units of the "
            f"positions{units}, or keep the near ones{to_mm}."
        )
    angles = np.degrees(data.delta_p()[:, 3:])
    for dof, values in zip(("rx", "rz"), angles[:, [0, 2]].T, strict=True):
        if values.max() > 135 and values.min() < -135:
            texts.append(
                f"Angles of {dof} wrap at 180 deg ({values.min():.1f} to {values.max():.1f} deg): "
                f"equal views get targets 360 deg apart; keep the near ones{to_deg}."
            )
    if (steep := np.abs(angles[:, 1]).max()) > 80:
        texts.append(
            f"Angles of ry come to {steep:.1f} deg: near 90 deg rx and rz are not separable; "
            f"keep the near ones{to_deg}."
        )
    return texts


def _is_imported(data: PoseImageSet) -> bool:
    """Whether a data set was made by `import`, whose options then help."""
    return "format" in data.source


def _grey_levels(images: NDArray[np.uint8]) -> tuple[NDArray[Any], ...]:
    """The level below which 99 % of the pixels lie, share of saturated ones, and contrast."""
    n_images, height, width = images.shape
    n_pixels, side = height * width, max(1, min(height, width) // 8)
    flat = images.reshape(n_images, -1)
    bright = np.partition(flat, int(0.99 * (n_pixels - 1)), axis=1)[:, int(0.99 * (n_pixels - 1))]
    saturated = (flat >= WHITE_LEVEL).mean(axis=1)
    rows, columns = height // side, width // side
    blocks = images[:, : rows * side, : columns * side].reshape(n_images, rows, side, columns, side)
    contrast = blocks.mean(axis=(2, 4), dtype=np.float32).std(axis=(1, 2))
    return bright, saturated, contrast


def _repeated(
    images: NDArray[np.uint8], T_world_cam: NDArray[np.float64], sound: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Which sound images equal an earlier one that was taken from another pose."""
    by_content: dict[bytes, list[int]] = defaultdict(list)
    for i in np.flatnonzero(sound):
        by_content[blake2b(images[i].tobytes(), digest_size=16).digest()].append(int(i))
    repeated = np.zeros(len(images), dtype=bool)
    for first, *others in by_content.values():
        moved = np.abs(T_world_cam[others] - T_world_cam[first]).max(axis=(1, 2), initial=0.0)
        repeated[others] = moved > 1e-6
    return repeated
