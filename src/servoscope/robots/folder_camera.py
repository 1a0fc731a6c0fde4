"""A camera whose images another program writes to a folder."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import CameraFaultError, DataSetError, InvalidInputError
from servoscope.formats.images import read_levels
from servoscope.robots.camera_image import camera_image
from servoscope.robots.options import check_range, split_options
from servoscope.storage.reading import without_advice
from servoscope.wording import one_line

OPTIONS: dict[str, Callable[[str], Any]] = {
    "image_width": int,
    "bit_depth": int,
    "delay": float,
    "timeout": float,
}
"""Of ``folder:PATH?name=value``."""

ENDINGS = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm", ".ppm", ".webp"}
"""Of the files that are taken for images."""

_PAUSE = 0.05


def folder_camera(text: str) -> FolderCamera:
    """The camera that is written ``folder:PATH?name=value``, without the kind."""
    path, options = split_options(text, OPTIONS)
    return FolderCamera(path, **options)


class FolderCamera:
    """A folder that another program fills with images, each in a file of a new name.

    A reading waits for a file that was not there at the call, until its size no longer changes and
    it is a whole image. Of several it is the last one. A file that is written over is not seen:
    whether its image was taken before the call cannot be known.

    Parameters
    ----------
    path : path-like
    image_width : int, optional
        Width that images are resized to, as `servoscope import` does, [px].
    bit_depth : int, optional
        Bits that the values of 16-bit files fill; they are not read without it.
    delay : float
        How much later than it was taken an image appears, [s]: files that appear within it are not
        taken.
    timeout : float
        How long an image may take, [s].

    Raises
    ------
    InvalidInputError
        If it is no folder, or a number is not of its range.

    Examples
    --------
    >>> from tempfile import mkdtemp
    >>> from threading import Timer
    >>> import cv2
    >>> folder = Path(mkdtemp())
    >>> def take():
    ...     cv2.imwrite(str(folder / "1.png"), np.full((3, 4), 7, np.uint8))
    >>> Timer(0.1, take).start()
    >>> FolderCamera(folder).read().shape
    (3, 4)
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        image_width: int | None = None,
        bit_depth: int | None = None,
        delay: float = 0.0,
        timeout: float = 5.0,
    ) -> None:
        self.path = Path(path)
        if not self.path.is_dir():
            raise InvalidInputError(
                f"The camera must be a folder, got {str(path)!r}; make it, or name the one that "
                "the images are written to."
            )
        check_range("image_width", image_width, 1, 1 << 16, "px")
        check_range("bit_depth", bit_depth, 8, 16)
        check_range("delay", delay, 0, 60, "s")
        check_range("timeout", timeout, 0.01, 600, "s")
        self.image_width, self.bit_depth = image_width, bit_depth
        self.delay, self.timeout = delay, timeout

    def read(self) -> NDArray[np.uint8]:
        """The grey image of a file that appears after the call, (height, width).

        Raises
        ------
        CameraFaultError
            If none does in time.
        """
        time.sleep(self.delay)
        known, end = set(self._names()), time.monotonic() + self.timeout
        before: dict[str, int] = {}
        reason = "see that its program writes, each image to a file of a new name"
        while time.monotonic() < end:
            time.sleep(_PAUSE)
            files = {name: self._stat(name) for name in self._names() if name not in known}
            sizes = {name: stat.st_size for name, stat in files.items() if stat is not None}
            whole = [name for name, size in sizes.items() if size and before.get(name) == size]
            before = sizes
            if not whole:
                continue
            newest = max(whole, key=lambda name: (files[name].st_mtime_ns, name))
            try:
                levels, _ = read_levels(self.path / newest)
                return camera_image(levels, self.image_width, self.bit_depth, newest)
            except (DataSetError, OSError) as error:
                reason = one_line(without_advice(error))
        raise CameraFaultError(
            f"No whole new image came to {self.path} within {self.timeout:g} s; {reason}."
        )

    def _names(self) -> list[str]:
        """The image files that are there."""
        try:
            return [name for name in os.listdir(self.path) if Path(name).suffix.lower() in ENDINGS]
        except OSError as error:
            raise CameraFaultError(f"{self.path} cannot be read: {one_line(error)}") from error

    def _stat(self, name: str) -> Any:
        """Size and age of a file; None if it has gone meanwhile."""
        try:
            return (self.path / name).stat()
        except OSError:
            return None
