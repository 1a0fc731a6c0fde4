"""The frames of a source before any image is read; what is left out of them, and why."""

from __future__ import annotations

import os
from collections import Counter, defaultdict
from collections.abc import Callable, Generator, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from unicodedata import normalize

import numpy as np
from numpy.typing import NDArray

from servoscope.errors import DataSetError
from servoscope.formats.images import Decoded, decode_files

NO_POSE = "without a pose near in time"
BAD_POSE = "with an unusable pose"
EQUAL_STAMPS = "stamps of several poses"
BAD_IMAGE = "with an unusable image"
FAR = "far from the reference"
THINNED = "between others, as there are more than are kept"
HELD_POSE = "with a pose that stays while the image changes"

_NAMES_SHOWN = 3


class Drops:
    """Names of what was left out, by reason.

    Examples
    --------
    >>> drops = Drops()
    >>> drops.add(BAD_IMAGE, ["left/0007.png"])
    >>> drops.counts()
    {'with an unusable image': 1}
    >>> print(drops)
    1 with an unusable image (left/0007.png)
    """

    def __init__(self) -> None:
        self._names: dict[str, dict[str, None]] = {}

    def add(self, reason: str, names: Iterable[str]) -> None:
        """Note that these were left out for this reason; each name counts once."""
        if names := dict.fromkeys(names):
            self._names.setdefault(reason, {}).update(names)

    def counts(self) -> dict[str, int]:
        """How many were left out, by reason."""
        return {reason: len(names) for reason, names in self._names.items()}

    def __str__(self) -> str:
        return ", ".join(
            f"{len(names)} {reason}{_examples(list(names)) if reason != FAR else ''}"
            for reason, names in self._names.items()
        )


def _examples(names: list[str]) -> str:
    shown = names if len(names) <= _NAMES_SHOWN else [*names[: _NAMES_SHOWN - 1], "..."]
    return f" ({', '.join(shown)})"


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
    read : callable, optional
        Yields the images of frames in their order, or why one cannot be read, given the frames and
        the width to resize to; by default they are files.
    """

    folder: Path
    names: list[str]
    numbers: NDArray[np.intp]
    T_world_cam: NDArray[np.float64]
    times: NDArray[np.float64] | None = None
    read: FrameReader | None = None

    def images(self, width: int | None = None) -> Generator[Decoded, None, None]:
        """The images in the order of the frames, or why one cannot be read."""
        return decode_files(self.paths, width) if self.read is None else self.read(self, width)

    def __len__(self) -> int:
        return len(self.names)

    @property
    def paths(self) -> list[str]:
        """Files of the images, as the disk spells them; or what they are called in messages."""
        if self.read is not None:
            return [f"{self.folder}, image {name}" for name in self.names]
        listings: dict[str, Listing] = {}
        return [_path_on_disk(str(self.folder), name, listings) for name in self.names]

    def take(self, kept: NDArray[np.bool_]) -> Frames:
        """The frames where `kept` is true."""
        return self.at(np.flatnonzero(kept))

    def at(self, places: NDArray[np.intp]) -> Frames:
        """The frames at these places."""
        return replace(
            self,
            names=[self.names[place] for place in places],
            numbers=self.numbers[places],
            T_world_cam=self.T_world_cam[places],
            times=None if self.times is None else self.times[places],
        )


FrameReader = Callable[[Frames, int | None], Generator[Decoded, None, None]]


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


Listing = tuple[dict[str, str], dict[str, str]]


def _path_on_disk(folder: str, name: str, listings: dict[str, Listing]) -> str:
    """The file of that name, whatever Unicode form or case its letters have on disk."""
    path = os.path.join(folder, name)
    if os.path.lexists(path):
        return path
    path = folder
    for part in name.split("/"):
        if not os.path.lexists(os.path.join(path, part)):
            if path not in listings:
                listings[path] = _files_by_name(path)
            exact, folded = listings[path]
            part = exact.get(part) or folded.get(part.casefold(), part)
        path = os.path.join(path, part)
    return path


def _files_by_name(folder: str) -> Listing:
    """Files of a folder by their names, and by these in small letters where one alone has them."""
    exact = {normalize("NFC", file): file for file in _list(folder)}
    n_alike = Counter(name.casefold() for name in exact)
    folded = {name.casefold(): file for name, file in exact.items()}
    return exact, {name: file for name, file in folded.items() if n_alike[name] == 1}


def _list(folder: str) -> list[str]:
    try:
        return os.listdir(folder)
    except OSError:
        return []


_LEAST_CHANGE = 0.5
_ROUNDED = 1e-9


def held_poses(images: NDArray[np.uint8], frames: Frames) -> NDArray[np.bool_]:
    """Which frames share their pose with others, though their images differ as those of others do.

    Several images taken from one pose differ by noise alone. Those whose first and later ones
    differ, in the median, by half as much as neighbours of different poses do were not taken there.

    Parameters
    ----------
    images : ndarray of shape (n, height, width), uint8
    frames : Frames
        Of n images.

    Returns
    -------
    ndarray of shape (n,), bool
    """
    held = np.zeros(len(frames), dtype=bool)
    numbers = np.round(frames.T_world_cam[:, :3].reshape(-1, 12) / _ROUNDED).astype(np.int64) + 0
    by_pose: dict[bytes, list[int]] = defaultdict(list)
    for i, row in enumerate(numbers):
        by_pose[row.tobytes()].append(i)
    shared = [members for members in by_pose.values() if len(members) > 1]
    moved = np.flatnonzero((numbers[1:] != numbers[:-1]).any(axis=1))
    if not shared or not moved.size:
        return held
    some = moved[:: 1 + len(moved) // 200]
    usual = np.median([_difference(images[i], images[i + 1]) for i in some])
    for first, *others in shared:
        changes = [_difference(images[first], images[i]) for i in others]
        held[[first, *others]] = np.median(changes) > max(_LEAST_CHANGE * usual, 1.0)
    return held


def _difference(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> float:
    """Mean difference of the grey levels."""
    return float(np.abs(a.astype(np.int16) - b).mean())
