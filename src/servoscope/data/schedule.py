"""Rings around the reference that images are taken in, as ``1000@1.0,400@0.2,400@0.03``."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

from servoscope.errors import InvalidInputError

MOST_IMAGES = 1_000_000
LARGEST_FACTOR = 4.0


class Ring(NamedTuple):
    """Images whose displacements are drawn from a share of the range."""

    n_images: int
    factor: float


Schedule = tuple[Ring, ...]

RECOMMENDED: Schedule = (Ring(40, 1.6),)
"""Images for positioning: beyond the range, so that a start at its border is within."""

_EXAMPLE = "1000@1.0,400@0.2"


def parse_schedule(text: str) -> Schedule:
    """The rings that a text names: ``N@FACTOR`` each, with commas between them, or ``default``.

    Examples
    --------
    >>> parse_schedule("1000@1.0,400@0.03")
    (Ring(n_images=1000, factor=1.0), Ring(n_images=400, factor=0.03))
    """
    if text.strip() == "default":
        return RECOMMENDED
    rings = []
    for word in text.split(","):
        n_images, _, factor = word.partition("@")
        try:
            rings.append((int(n_images), float(factor)))
        except ValueError:
            raise InvalidInputError(
                f"A schedule is rings of images@factor, such as {_EXAMPLE}, or default; "
                f"got {word.strip()!r}."
            ) from None
    return check_schedule(rings)


def format_schedule(schedule: Iterable[tuple[int, float]]) -> str:
    """The text that `parse_schedule` reads.

    Examples
    --------
    >>> format_schedule(((1000, 1.0), (400, 0.03)))
    '1000@1.0,400@0.03'
    """
    return ",".join(f"{n_images}@{float(factor)!r}" for n_images, factor in schedule)


def check_schedule(schedule: Iterable[tuple[int, float]]) -> Schedule:
    """The rings themselves, if each has images and a factor above 0 and up to 4, and all no more
    than a million images.
    """
    try:
        rings = tuple(Ring(*ring) for ring in schedule)
    except TypeError:
        raise InvalidInputError(
            f"schedule must be pairs (n_images, factor), got {schedule!r}."
        ) from None
    for ring in rings:
        if not isinstance(ring.n_images, int) or not 1 <= ring.n_images <= MOST_IMAGES:
            raise InvalidInputError(
                f"A ring has a whole number of images from 1 to {MOST_IMAGES}, "
                f"got {ring.n_images!r}."
            )
        number = isinstance(ring.factor, int | float) and math.isfinite(ring.factor)
        if not number or not 0 < ring.factor <= LARGEST_FACTOR:
            raise InvalidInputError(
                f"A ring's factor must be above 0 and at most {LARGEST_FACTOR:g}, "
                f"got {ring.factor!r}."
            )
    total = sum(ring.n_images for ring in rings)
    if total > MOST_IMAGES:
        raise InvalidInputError(
            f"A schedule has at most {MOST_IMAGES} images, got {total}; take fewer in its rings."
        )
    return tuple(Ring(ring.n_images, float(ring.factor)) for ring in rings)
