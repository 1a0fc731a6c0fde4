"""Image files as grey 8-bit images, one by one or as a stack."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from os import PathLike
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from servoscope.errors import DataSetError

GreyImage = NDArray[np.uint8]


def read_grey(path: str | PathLike[str], width: int | None = None) -> GreyImage:
    """The image in a file, grey.

    Colour is turned grey by ITU-R 601 luma, 16-bit values keep their upper eight bits, and
    transparency and any rotation noted in the file's EXIF data are ignored: a pose belongs to
    the rows and columns of the sensor.

    Parameters
    ----------
    path : path-like
    width : int, optional
        Width to resize to, keeping the aspect ratio, [px]; shrunk by averaging over areas.

    Returns
    -------
    ndarray of shape (height, width), uint8

    Raises
    ------
    DataSetError
        If the file is missing, truncated or not an image.
    """
    grey = _decode(Path(path))
    if width is None or width == grey.shape[1]:
        return grey
    height = max(1, round(grey.shape[0] * width / grey.shape[1]))
    method = cv2.INTER_AREA if width < grey.shape[1] else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(grey, (width, height), interpolation=method), dtype=np.uint8)


def read_stack(
    paths: Sequence[Path],
    shape: tuple[int, int],
    width: int | None = None,
    on_progress: Callable[[int], object] | None = None,
) -> tuple[NDArray[np.uint8], list[DataSetError | None]]:
    """Grey images of one shape from many files, read side by side.

    Parameters
    ----------
    paths : sequence of n Path
    shape : (height, width)
        Of every image, after resizing, [px].
    width : int, optional
        Width to resize to, [px].
    on_progress : callable, optional
        Called with the number of files read.

    Returns
    -------
    images : ndarray of shape (n, height, width), uint8
        Black where a file could not be read.
    errors : list of n DataSetError or None
        Why a file could not be read, or what other shape it has.
    """
    images = np.zeros((len(paths), *shape), np.uint8)

    def read_into_stack(i: int) -> DataSetError | None:
        try:
            image = read_grey(paths[i], width)
        except DataSetError as error:
            return error
        if image.shape != shape:
            return DataSetError(
                f"{paths[i]} is {_size(image.shape)} px, but the reference image is "
                f"{_size(shape)} px; all images must be of one size and aspect ratio."
            )
        images[i] = image
        return None

    errors = []
    pool = ThreadPoolExecutor()
    try:
        for error in pool.map(read_into_stack, range(len(paths))):
            errors.append(error)
            if on_progress is not None:
                on_progress(len(errors))
    finally:
        pool.shutdown(cancel_futures=True)
    return images, errors


def which_readable(paths: Sequence[Path]) -> NDArray[np.bool_]:
    """Which of the files hold a whole image."""

    def is_readable(path: Path) -> bool:
        try:
            read_grey(path)
        except DataSetError:
            return False
        return True

    with ThreadPoolExecutor() as pool:
        return np.fromiter(pool.map(is_readable, paths), dtype=bool, count=len(paths))


def _decode(path: Path) -> GreyImage:
    try:
        with Image.open(path) as image:
            image.load()
            return _grey(image)
    except FileNotFoundError as error:
        raise DataSetError(
            f"{path} is missing, though a pose is given for it; restore it, remove its pose, or "
            "leave it out with --skip-bad."
        ) from error
    except Exception as error:  # Pillow's decoders raise of every kind on damaged files
        reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
        reason = " ".join(reason.replace(f" {str(path)!r}", "").split())
        raise DataSetError(
            f"{path} is not a whole image ({reason}); replace it, remove its pose, or leave it "
            "out with --skip-bad."
        ) from error


def _grey(image: Image.Image) -> GreyImage:
    if image.mode == "F":
        raise ValueError("floating-point pixels, save it with 8 or 16 bits")
    if image.mode.startswith("I"):
        values = np.asarray(image)
        if values.min() < 0 or values.max() > 65535:
            raise ValueError("pixels of more than 16 bits, save it with 8 or 16 bits")
        return (values >> 8).astype(np.uint8)
    return np.array(image.convert("L"))


def _size(shape: tuple[int, ...]) -> str:
    return f"{shape[1]} x {shape[0]}"
