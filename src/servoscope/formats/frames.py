"""The frames of a source: names, poses and times, before any image is read."""

from __future__ import annotations

import os
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from unicodedata import normalize

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import DataSetError


@dataclass(frozen=True, eq=False)
class Frames:
    """Images by name, each with its pose.

    Parameters
    ----------
    folder : Path
        That the names are relative to.
    names : list of n str
        All different.
    numbers : ndarray of shape (n,), int
        Place of each in the list that it was read from, counting from 0.
    T_world_cam : ndarray of shape (n, 4, 4)
        [m], OpenCV axes.
    times : ndarray of shape (n,), optional
        [s].
    """

    folder: Path
    names: list[str]
    numbers: NDArray[np.intp]
    T_world_cam: NDArray[np.float64]
    times: NDArray[np.float64] | None = None

    def __len__(self) -> int:
        return len(self.names)

    @property
    def paths(self) -> list[str]:
        """Files of the images, as the disk spells them."""
        listings: dict[str, dict[str, str]] = {}
        return [_path_on_disk(str(self.folder), name, listings) for name in self.names]

    def take(self, kept: NDArray[np.bool_]) -> Frames:
        """The frames where `kept` is true."""
        return self.at(np.flatnonzero(kept))

    def at(self, places: NDArray[np.intp]) -> Frames:
        """The frames at these places."""
        return Frames(
            self.folder,
            [self.names[place] for place in places],
            self.numbers[places],
            self.T_world_cam[places],
            None if self.times is None else self.times[places],
        )


def check_names_differ(names: list[str], path: Path) -> None:
    """Check that no image is named twice.

    Raises
    ------
    DataSetError
        Whatever the options are: which of its poses is right is not known.
    """
    repeated = [name for name, count in Counter(names).items() if count > 1]
    if repeated:
        raise DataSetError(
            f"{path} names {repeated[0]} more than once ({len(repeated)} such images); keep one "
            "pose for each image."
        )


def _path_on_disk(folder: str, name: str, listings: dict[str, dict[str, str]]) -> str:
    """The file of that name, whatever Unicode form its letters have on disk."""
    path = os.path.join(folder, name)
    if name.isascii() or os.path.lexists(path):
        return path
    path = folder
    for part in name.split("/"):
        if not os.path.lexists(os.path.join(path, part)):
            if path not in listings:
                listings[path] = {normalize("NFC", file): file for file in _list(path)}
            part = listings[path].get(part, part)
        path = os.path.join(path, part)
    return path


def _list(folder: str) -> list[str]:
    try:
        return os.listdir(folder)
    except OSError:
        return []
