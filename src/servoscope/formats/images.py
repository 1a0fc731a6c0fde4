"""Image files as grey 8-bit images, one by one or as a stack."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, closing
from os import PathLike
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from servoscope.errors import DataSetError, ServoscopeWarning
from servoscope.storage.reading import (
    LARGEST_IMAGE,
    open_image,
    open_image_bytes,
    read_bytes,
    without_advice,
    words,
)
from servoscope.storage.stacks import gathered

BIT_DEPTHS = (8, 10, 12, 14, 16)
"""Bits that cameras fill, of which the least that hold the largest grey level are taken."""

IMAGE_ENDINGS = (
    *(".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".ppm", ".pgm", ".webp", ".gif"),
    *(".jp2", ".tga"),
)
"""Endings by which images are known where nothing names them."""


def filled_bits(brightest: int, bit_depth: int | None, where: str) -> int:
    """How many bits the grey levels of 16-bit files fill.

    Parameters
    ----------
    brightest : int
        Largest grey level of all images, before they are resized.
    bit_depth : int, optional
        What the user says.
    where : str
        The images, for errors.

    Raises
    ------
    DataSetError
        If a grey level needs more bits than the user says.

    Warns
    -----
    ServoscopeWarning
        If nobody says, and they are fewer than 16.

    Examples
    --------
    >>> filled_bits(4095, 12, "images")
    12
    """
    if bit_depth is not None:
        if brightest >= 2**bit_depth:
            raise DataSetError(
                f"{where}: the largest grey level is {brightest}, which {bit_depth} bits do not "
                f"hold; give --bit-depth {max(9, int(brightest).bit_length())} or leave it out."
            )
        return bit_depth
    bits = next(bits for bits in BIT_DEPTHS if brightest < 2**bits)
    if bits < 16:
        warnings.warn(
            f"{where}: 16-bit files whose largest grey level is {brightest} were taken to fill "
            f"{bits} bits; if they fill others, say so with --bit-depth.",
            ServoscopeWarning,
            stacklevel=3,
        )
    return bits


def to_eight_bits(levels: NDArray[np.uint8] | NDArray[np.uint16], bits: int) -> NDArray[np.uint8]:
    """The upper eight of the bits that are filled; 8-bit images as they are.

    Examples
    --------
    >>> to_eight_bits(np.array([[4095, 16, 15]], np.uint16), 12)
    array([[255,   1,   0]], dtype=uint8)
    """
    if levels.dtype == np.uint8:
        return levels  # type: ignore[return-value]
    in_memory = math.inf if isinstance(levels, np.ndarray) else 0
    upper = ((level >> (bits - 8)).astype(np.uint8) for level in levels)
    return gathered(upper, levels.shape, "uint8", in_memory)


_FILES_AT_ONCE = 256

GreyLevels = NDArray[np.uint8] | NDArray[np.uint16]

Decoded = tuple[GreyLevels, int] | DataSetError
"""A grey image and its largest level before it is resized, or why it cannot be read."""


def read_grey(
    path: str | PathLike[str], width: int | None = None, bit_depth: int | None = None
) -> NDArray[np.uint8]:
    """The image in a file, grey, of 8 bits.

    Colour is turned grey by ITU-R 601 luma, of 16-bit values the upper eight of the bits that are
    filled are kept, and transparency and any rotation noted in the file's EXIF data are ignored: a
    pose belongs to the rows and columns of the sensor.

    Parameters
    ----------
    path : path-like
    width : int, optional
        Width to resize to, keeping the aspect ratio, [px]; shrunk by averaging over areas.
    bit_depth : int, optional
        Bits that the values of a 16-bit file fill; by default the least of 8, 10, 12, 14 and 16
        that hold its largest.

    Returns
    -------
    ndarray of shape (height, width), uint8

    Raises
    ------
    DataSetError
        If the file is missing, truncated, not an image or of floating-point pixels.

    Warns
    -----
    ServoscopeWarning
        If a 16-bit file is taken to fill fewer bits.
    """
    levels, brightest = read_levels(Path(path), width)
    bits = 8 if levels.dtype == np.uint8 else filled_bits(brightest, bit_depth, str(path))
    return to_eight_bits(levels, bits)


def read_levels(path: Path, width: int | None = None) -> tuple[GreyLevels, int]:
    """The grey image in a file as uint8 or uint16, and its largest level before it is resized.

    Raises
    ------
    DataSetError
        As `read_grey`.
    """
    return resized(_decode_file(path), width, path)


def resized(levels: GreyLevels, width: int | None, where: object) -> tuple[GreyLevels, int]:
    """An image of the wanted width, and its largest level before it is resized.

    Raises
    ------
    DataSetError
        If it would have more pixels than `LARGEST_IMAGE`.
    """
    brightest = int(levels.max())
    if width is None or width == levels.shape[1]:
        return levels, brightest
    height = max(1, round(levels.shape[0] * width / levels.shape[1]))
    if height * width > LARGEST_IMAGE:
        raise DataSetError(
            f"{where} would be {width} x {height} px, more than {LARGEST_IMAGE} pixels; take a "
            "smaller --image-width."
        )
    method = cv2.INTER_AREA if width < levels.shape[1] else cv2.INTER_LINEAR
    image: Any = cv2.resize(levels, (width, height), interpolation=method)
    return image, brightest


def decode_files(
    paths: Sequence[str | Path], width: int | None = None
) -> Generator[Decoded, None, None]:
    """The grey images in files, in their order, read side by side; or why one cannot be read."""

    def decoded(path: str | Path) -> Decoded:
        try:
            return read_levels(Path(path), width)
        except DataSetError as error:
            return error

    pool = ThreadPoolExecutor()
    try:
        for start in range(0, len(paths), _FILES_AT_ONCE):
            yield from pool.map(decoded, paths[start : start + _FILES_AT_ONCE])
    finally:
        pool.shutdown(cancel_futures=True)


def stack_images(
    decoded: Generator[Decoded, None, None],
    names: Sequence[str | Path],
    like: GreyLevels,
    on_progress: Callable[[int], object] | None = None,
    *,
    skip_bad: bool = False,
    in_memory: float = math.inf,
) -> tuple[GreyLevels, int, list[DataSetError | None]]:
    """Grey images of one shape in one array, or in a stack on disk.

    Parameters
    ----------
    decoded : generator of n
        As `decode_files` yields them; it is closed at the end, or where an error ends it.
    names : sequence of n
        What messages call them.
    like : ndarray of shape (height, width), uint8 or uint16
        An image that all must have the shape and type of.
    on_progress : callable, optional
        Called with the number of images read.
    skip_bad : bool
        Go on after an image that cannot be read, rather than raise its error.
    in_memory : float
        Images that take more bytes than that are gathered on disk.

    Returns
    -------
    images : ndarray of shape (n, height, width), uint8 or uint16
        Black where one could not be read.
    brightest : int
        Largest grey level of all, before they are resized.
    errors : list of n DataSetError or None
        Why an image could not be read, or what other shape or type it has.

    Raises
    ------
    DataSetError
        The first of these errors, unless they are to be skipped.
    """
    errors: list[DataSetError | None] = []
    brightest, black = 0, np.zeros_like(like)

    def readable() -> Iterator[GreyLevels]:
        nonlocal brightest
        for name, found in zip(names, decoded, strict=True):
            error = found if isinstance(found, DataSetError) else _unlike(found[0], like, name)
            if error is not None and not skip_bad:
                raise error
            errors.append(error)
            if error is None and not isinstance(found, DataSetError):
                brightest = max(brightest, found[1])
                yield found[0]
            else:
                yield black
            if on_progress is not None:
                on_progress(len(errors))

    with closing(decoded):
        images = gathered(readable(), (len(names), *like.shape), like.dtype.name, in_memory)
    return images, brightest, errors


def _unlike(image: GreyLevels, like: GreyLevels, name: str | Path) -> DataSetError | None:
    if image.shape != like.shape:
        return DataSetError(
            f"{name} is {_size(image.shape)} px, but the reference image is "
            f"{_size(like.shape)} px; all images must be of one size and aspect ratio."
        )
    if image.dtype != like.dtype:
        return DataSetError(
            f"{name} is of {image.dtype}, but the reference image of {like.dtype}; save "
            "all images with the same bits."
        )
    return None


_WHAT_TO_DO = "replace it, remove its pose, or leave it out with --skip-bad."


def decode_bytes(content: bytes, where: str) -> GreyLevels:
    """The grey image that the bytes of an image file hold.

    Raises
    ------
    DataSetError
        As `read_grey`.
    """
    return _decode(open_image_bytes(content, where, DataSetError), where, lambda: content)


def _decode_file(path: Path) -> GreyLevels:
    if not os.path.exists(path):
        raise DataSetError(f"{path} is missing, though a pose is given for it; {_WHAT_TO_DO}")
    return _decode(
        open_image(path, DataSetError),
        str(path),
        lambda: read_bytes(path, DataSetError, 8 * LARGEST_IMAGE),
    )


def _decode(
    opened: AbstractContextManager[Image.Image], where: str, content: Callable[[], bytes]
) -> GreyLevels:
    try:
        with opened as image:
            return _grey(image, content)
    except DataSetError as error:
        raise DataSetError(f"{without_advice(error)}; {_WHAT_TO_DO}") from error
    except Exception as error:  # Pillow's decoders raise of every kind on damaged files
        raise DataSetError(
            f"{where} is not a whole image ({words(error)}); {_WHAT_TO_DO}"
        ) from error


def _grey(image: Image.Image, content: Callable[[], bytes]) -> GreyLevels:
    is_wide_colour = not image.mode.startswith("I") and ";16" in str(getattr(image, "tile", ""))
    image.load()
    if image.mode == "F":
        raise ValueError("floating-point pixels, save it with 8 or 16 bits")
    if image.mode.startswith("I"):
        values = np.asarray(image)
        if values.min() < 0 or values.max() > 65535:
            raise ValueError("pixels of more than 16 bits, save it with 8 or 16 bits")
        return values.astype(np.uint16)
    if is_wide_colour:
        return _luma_of_sixteen_bits(content())
    return np.array(image if image.mode == "L" else image.convert("L"))


def _luma_of_sixteen_bits(content: bytes) -> NDArray[np.uint16]:
    """Luma of a colour image of 16 bits, of which Pillow keeps the upper eight only."""
    values = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    if values is None or values.dtype != np.uint16 or values.ndim != 3:
        raise ValueError("colour of 16 bits that cannot be read, save it grey")
    return np.asarray(cv2.cvtColor(values[..., :3], cv2.COLOR_BGR2GRAY), dtype=np.uint16)


def _size(shape: tuple[int, ...]) -> str:
    return f"{shape[1]} x {shape[0]}"
