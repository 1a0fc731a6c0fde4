"""What a user may choose when importing images with poses, whatever their format."""

from __future__ import annotations

from dataclasses import dataclass, fields
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

from servoscope.errors import InvalidInputError
from servoscope.storage.sizes import DEFAULT_MEMORY, parse_bytes

Direction = Literal["camera-to-world", "world-to-camera"]
Units = Literal["m", "mm"]
Axes = Literal["opencv", "opengl"]
QuaternionOrder = Literal["xyzw", "wxyz"]

MOST_NEIGHBOURS = "most-neighbours"
"""The `reference` that asks for the frame with most neighbours."""


@dataclass(frozen=True, kw_only=True)
class ImportOptions:
    """Options of every format. The conventions are never guessed from the data.

    Parameters
    ----------
    image_width : int, optional
        Width to resize images to, keeping their aspect ratio [px]; unchanged by default.
    reference : str
        Name of the reference frame, or "most-neighbours" for the frame that has most others
        within the limits max_mm and max_deg.
    reference_index : int, optional
        Number of the reference frame in the list of images, counting from 0, instead of its
        name.
    max_mm : float, optional
        Keep only frames whose camera is at most this far from the reference [mm]; all by
        default.
    max_deg : float, optional
        Keep only frames turned by at most this angle from the reference [deg]; all by default.
    max_images : int, optional
        Keep at most so many of these, evenly chosen; all by default, of a bag or a video as many as
        512 MB hold.
    pivot_mm : float
        Distance from the camera along its optical axis of the pivot that displacements are
        taken about [mm], best the distance of the part; 0 takes them about the camera.
    direction : {"camera-to-world", "world-to-camera"}
        What the poses map: camera coordinates to world, so that tx, ty and tz are the position
        of the camera; or world coordinates to camera.
    units : {"m", "mm"}, optional
        Unit of the translations; by default that of the format, m in most.
    axes : {"opencv", "opengl"}
        Camera axes of the poses: opencv has x right, y down, z forward; opengl has x right,
        y up, z backward.
    bit_depth : int, optional
        Bits that the grey levels of 16-bit files fill, 8 to 16; by default the least of 8, 10, 12,
        14 and 16 that hold the largest of all images.
    split : {"auto", "random", "blocks"}
        How images are split for training and testing: at random, by blocks of time, or by
        blocks wherever times are known (auto).
    memory : str
        Such as "1GB": images that take more than a quarter of it are kept on disk while they are
        read, in the folder for temporary files (TMPDIR).
    skip_bad : bool
        Leave out unusable images and poses, and images that show nothing, and count them, instead
        of stopping at the first.

    Raises
    ------
    InvalidInputError
        If a value is out of its range.

    Examples
    --------
    >>> ImportOptions(units="mm", max_mm=150, max_deg=20).direction
    'camera-to-world'
    """

    image_width: int | None = None
    reference: str = MOST_NEIGHBOURS
    reference_index: int | None = None
    max_mm: float | None = None
    max_deg: float | None = None
    max_images: int | None = None
    pivot_mm: float = 550.0
    direction: Direction = "camera-to-world"
    units: Units | None = None
    axes: Axes = "opencv"
    bit_depth: int | None = None
    split: Literal["auto", "random", "blocks"] = "auto"
    memory: str = DEFAULT_MEMORY
    skip_bad: bool = False

    def __post_init__(self) -> None:
        for name, choices in _choices(type(self)).items():
            self._check_choice(name, choices)
        if self.reference != MOST_NEIGHBOURS and self.reference_index is not None:
            raise InvalidInputError(
                f"Give reference ({self.reference!r}) or reference_index "
                f"({self.reference_index}), not both."
            )
        parse_bytes(self.memory)
        for name in ("max_mm", "max_deg", "image_width"):
            self._check_number(name, above_zero=True)
        if self.bit_depth is not None and self.bit_depth not in range(8, 17):
            raise InvalidInputError(f"bit_depth must be from 8 to 16, got {self.bit_depth}.")
        if self.max_images is not None and not self.max_images >= 2:
            raise InvalidInputError(f"max_images must be at least 2, got {self.max_images}.")
        for name in ("pivot_mm", "reference_index"):
            self._check_number(name, above_zero=False)

    @property
    def length_unit(self) -> Units:
        """Unit of the translations: as the user says, or of the format."""
        return self.units or "m"

    @property
    def names_reference(self) -> bool:
        """Whether the user named the reference frame, by name or by number."""
        return self.reference != MOST_NEIGHBOURS or self.reference_index is not None

    def _check_choice(self, name: str, choices: tuple[Any, ...]) -> None:
        if getattr(self, name) not in choices:
            named = ", ".join(choice for choice in choices if choice is not None)
            raise InvalidInputError(f"{name} must be one of {named}, got {getattr(self, name)!r}.")

    def _check_number(self, name: str, *, above_zero: bool) -> None:
        value = getattr(self, name)
        if value is None or (np.isfinite(value) and (value > 0 or (value == 0 and not above_zero))):
            return
        range_ = "above 0" if above_zero else "not below 0"
        raise InvalidInputError(f"{name} must be a finite number {range_}, got {value}.")


def _choices(options: type[ImportOptions]) -> dict[str, tuple[Any, ...]]:
    """What each option with fixed choices may be; None too where it may be left out."""
    hints, choices = get_type_hints(options), {}
    for field in fields(options):
        hint = hints[field.name]
        parts = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
        fixed = [part for part in parts if get_origin(part) is Literal]
        if fixed and {*fixed, NoneType} >= set(parts):
            none = (None,) if NoneType in parts else ()
            choices[field.name] = (*get_args(fixed[0]), *none)
    return choices
